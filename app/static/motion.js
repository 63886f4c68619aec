// The mechanism through one revolution of its drive, when somebody asks for it: played, slowly, paused, or by the slider;
// worn pins in their sockets beside it, large. Positions come from the service; who wants less motion has the slider.
"use strict";

(() => {
  const SECONDS = 4;
  const SLOWER = 5;
  const SOCKET = 50;
  const PIN = 34;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  const shown = new WeakMap();

  const part = (box, name) => box.querySelector(`[data-motion-${name}]`);

  const prepare = () => {
    for (const box of document.querySelectorAll("[data-motion]")) {
      box.hidden = false;
      part(box, "play").hidden = part(box, "slow").parentElement.hidden = calm.matches;
    }
  };

  const element = (name, attributes, parent) => {
    const made = parent.appendChild(document.createElementNS(parent.namespaceURI, name));
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };

  // A pin's way in its socket, the gap between them as large as it can be drawn.
  const magnify = (pin, into) => {
    const figure = into.appendChild(document.createElement("figure"));
    const gap = SOCKET - PIN;
    const drawing = element("svg", { viewBox: "-66 -66 132 132", role: "img" }, figure);
    element("title", {}, drawing).textContent = `Pin of joint ${pin.joint} in its socket`;
    element("circle", { r: SOCKET, class: "socket" }, drawing);
    const way = pin.at.map(([x, y]) => `${(gap * x).toFixed(1)} ${(-gap * y).toFixed(1)}`);
    const disc = element("circle", { r: PIN, class: "pin" }, drawing);
    element("path", { d: `M${way.join(" L")} Z`, class: "way" }, drawing);
    const middle = element("circle", { r: 2.5, class: "middle" }, drawing);
    const text = figure.appendChild(document.createElement("figcaption"));
    text.textContent = `${pin.joint}: ${Math.round(pin.clearance_um)} µm, simulated; the gap is drawn large.`;
    return (share) => {
      const [x, y] = pin.at[Math.floor(share * pin.at.length) % pin.at.length];
      for (const each of [disc, middle]) each.setAttribute("transform", `translate(${gap * x} ${-gap * y})`);
      disc.classList.toggle("touching", Math.hypot(x, y) >= 1);
    };
  };

  const load = async (box) => {
    if (!shown.has(box)) {
      const answer = await fetch(box.dataset.motion);
      if (!answer.ok) throw new Error(String(answer.status));
      const moving = await answer.json();
      const drawing = box.parentElement.querySelector("svg.machine-drawing");
      drawing.setAttribute("viewBox", moving.view_box);
      drawing.classList.add("moved");
      const links = Object.entries(moving.transforms).flatMap(([name, steps]) =>
        [...drawing.getElementsByClassName(name)].map((each) => [each, steps.map((step) => step.match(/-?[\d.]+/g).map(Number))]));
      part(box, "pins").replaceChildren();
      shown.set(box, { links, pins: moving.pins.map((pin) => magnify(pin, part(box, "pins"))), share: 0, playing: 0 });
    }
    return shown.get(box);
  };

  // Straight between two positions; angles, the third of five numbers, by the shorter way round.
  const between = (steps, share) => {
    const at = share * steps.length;
    const [a, b] = [steps[Math.floor(at) % steps.length], steps[Math.floor(at + 1) % steps.length]];
    const [x, y, turn, ...about] = a.map((value, k) => {
      const more = k === 2 ? ((((b[k] - value + 180) % 360) + 360) % 360) - 180 : b[k] - value;
      return value + (at % 1) * more;
    });
    return `translate(${x.toFixed(2)} ${y.toFixed(2)})` + (about.length ? ` rotate(${turn.toFixed(2)} ${about.join(" ")})` : "");
  };

  const pose = (box, state, share) => {
    state.share = share % 1;
    for (const [each, steps] of state.links) each.setAttribute("transform", between(steps, state.share));
    for (const pin of state.pins) pin(state.share);
    const degrees = Math.round(360 * state.share) % 360;
    const slider = part(box, "at");
    slider.value = String(degrees);
    slider.setAttribute("aria-valuetext", `${degrees} degrees`);
  };

  const stop = (box, state, text) => {
    cancelAnimationFrame(state.playing);
    state.playing = 0;
    part(box, "play").textContent = text;
  };

  const play = (box, state) => {
    let last = performance.now();
    const frame = (now) => {
      const seconds = SECONDS * (part(box, "slow").checked ? SLOWER : 1);
      const share = state.share + Math.max(0, now - last) / (1000 * seconds);  // a frame may bear a time before the click
      last = Math.max(now, last);
      pose(box, state, share);
      if (share >= 1 || !box.isConnected) stop(box, state, "Show one revolution");
      else state.playing = requestAnimationFrame(frame);
    };
    part(box, "play").textContent = "Pause";
    state.playing = requestAnimationFrame(frame);
  };

  const act = async (event, what) => {
    const box = event.target.closest?.("[data-motion]");
    if (!box) return;
    try {
      part(box, "text").textContent = shown.has(box) ? "" : "One moment";
      const state = await load(box);
      part(box, "text").textContent = "";
      what(box, state);
    } catch (error) {
      part(box, "text").textContent = "The motion of this machine could not be computed.";
    }
  };

  document.addEventListener("click", (event) => {
    if (!event.target.closest?.("[data-motion-play]")) return;
    act(event, (box, state) => (state.playing ? stop(box, state, "Go on") : play(box, state)));
  });
  document.addEventListener("input", (event) => {
    if (!event.target.matches?.("[data-motion-at]")) return;
    const degrees = Number(event.target.value);
    act(event, (box, state) => {
      if (state.playing) stop(box, state, "Go on");
      pose(box, state, degrees / 360);
    });
  });
  document.addEventListener("DOMContentLoaded", prepare);
  document.addEventListener("htmx:after:swap", prepare);
  calm.addEventListener("change", prepare);
})();
