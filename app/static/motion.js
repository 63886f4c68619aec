// The mechanism through one revolution of its drive, when somebody asks for it. The positions come from the service;
// who wants less motion steps through them instead.
"use strict";

(() => {
  const SECONDS = 4;
  const STEPS = 12;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  const known = new Map();

  const prepare = () => {
    for (const button of document.querySelectorAll("[data-motion]")) {
      button.hidden = false;
      button.textContent = calm.matches ? "Step through one revolution" : "Show one revolution";
    }
  };

  const load = async (place) => {
    if (!known.has(place)) {
      const answer = await fetch(place);
      if (!answer.ok) throw new Error(String(answer.status));
      known.set(place, await answer.json());
    }
    return known.get(place);
  };

  const parts = (drawing, moving) =>
    Object.entries(moving.transforms).flatMap(([name, steps]) =>
      [...drawing.getElementsByClassName(name)].map((element) => [element, steps]));

  const pose = (found, share) => {
    for (const [element, steps] of found) {
      element.setAttribute("transform", steps[Math.floor(share * steps.length) % steps.length]);
    }
  };

  const play = (button, found) => {
    const start = performance.now();
    const frame = (now) => {
      const share = Math.max(0, now - start) / (1000 * SECONDS);  // a frame may bear a time before the click
      pose(found, Math.min(share, 1));
      if (share < 1 && button.isConnected) requestAnimationFrame(frame);
      else button.disabled = false;
    };
    button.disabled = true;
    requestAnimationFrame(frame);
  };

  document.addEventListener("click", async (event) => {
    const button = event.target.closest?.("[data-motion]");
    if (!button) return;
    const card = button.closest(".card");
    const text = card.querySelector("[data-motion-text]");
    const drawing = card.querySelector("svg.machine-drawing");
    try {
      const moving = await load(button.dataset.motion);
      drawing.setAttribute("viewBox", moving.view_box);
      drawing.classList.add("moved");
      const found = parts(drawing, moving);
      if (calm.matches) {
        const step = ((Number(button.dataset.step) || 0) + 1) % STEPS;
        button.dataset.step = String(step);
        pose(found, step / STEPS);
        text.textContent = `Position ${step} of ${STEPS}`;
      } else {
        play(button, found);
      }
    } catch (error) {
      text.textContent = "The motion of this machine could not be computed.";
    }
  });
  document.addEventListener("DOMContentLoaded", prepare);
  document.addEventListener("htmx:after:swap", prepare);
  calm.addEventListener("change", prepare);
})();
