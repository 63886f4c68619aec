// A build that goes on: every event of its stream is a reason to ask for its page again, of which only what changed is put
// in place, so that a button keeps the focus and a screen reader hears of a new state alone.
"use strict";

(() => {
  const ENDED = ["done", "failed", "cancelled", "worker_lost"];

  const say = (text) => {
    const place = document.getElementById("following-text");
    if (place && place.textContent !== text) place.textContent = text;
  };

  const replace = (section, text) => {
    const fresh = new DOMParser().parseFromString(text, "text/html");
    window.jointplay.localize(fresh);
    for (const part of fresh.querySelectorAll("[data-part]")) {
      const own = section.querySelector(`[data-part="${part.dataset.part}"]`);
      if (!own) continue;
      own.className = part.className;
      if (part.dataset.part !== "card" && own.innerHTML !== part.innerHTML) own.replaceChildren(...part.childNodes);
    }
  };

  const follow = (section) => {
    const place = section.dataset.place;
    const stream = new EventSource(section.dataset.events);
    let asked = null;

    // Who asks anew waits for the answer before no more.
    const show = async () => {
      asked?.abort();
      asked = new AbortController();
      try {
        const answer = await fetch(place, { headers: { "HX-Request": "true" }, signal: asked.signal });
        if (answer.status === 401) {
          stream.close();
          window.location.assign(answer.headers.get("HX-Redirect"));
          return;
        }
        if (!answer.ok) throw new Error(String(answer.status));
        replace(section, await answer.text());
        say("");
      } catch (error) {
        if (error.name !== "AbortError") say("The service does not answer; what is shown may be old.");
      }
    };

    // The browser tries no more: the build has ended, the session is over, or the service refuses.
    const closed = async () => {
      await show();
      if (!ENDED.some((state) => section.querySelector(`.build.${state}`))) {
        say("This page does not follow the build any more; load it again.");
      }
    };

    stream.addEventListener("state", (event) => {
      if (ENDED.includes(JSON.parse(event.data).state)) stream.close();
      show();
    });
    stream.addEventListener("error", () => {
      if (stream.readyState === EventSource.CONNECTING) say("The connection is lost; trying again…");
      else closed();
    });
    window.addEventListener("pagehide", () => stream.close());
  };

  document.addEventListener("DOMContentLoaded", () => {
    const section = document.querySelector("#following[data-events]");
    if (section) follow(section);
  });
})();
