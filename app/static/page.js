// What all forms share: which field is wrong, where the eye goes after an answer, and what is said when none came.
// All listeners are the document's, because going back in the browser's history replaces the page.
"use strict";

(() => {
  const byId = (id) => document.getElementById(id);

  // An element with its properties and attributes, and what is in it.
  const make = (name, given = {}, ...inside) => {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(given)) {
      if (key in made) made[key] = value;
      else made.setAttribute(key, value);
    }
    made.append(...inside);
    return made;
  };

  // A row of a table: all heads of columns, or one of its row and figures.
  const addRow = (part, scope, inside) => part.append(make("tr", {}, ...inside.map((each, index) => (index && scope === "row" ? make("td", {}, each) : make("th", { scope }, each)))));

  const mark = () => {
    for (const slot of document.querySelectorAll(".error[id]")) {
      const field = byId(slot.id.slice("error-".length));
      if (!field) continue;
      // A group of fields cannot be called invalid to a screen reader; it is described by the message.
      const attribute = field.tagName === "FIELDSET" ? "data-wrong" : "aria-invalid";
      const wrong = Boolean(slot.textContent.trim());
      if (!wrong) field.removeAttribute(attribute);
      else field.setAttribute(attribute, "true");
      const folded = wrong && field.closest("details");
      if (folded) folded.open = true;
    }
  };

  const noAnswer = () => byId("result").replaceChildren(make("div", { className: "card refusal", role: "alert" }, "The service did not answer. Is it still running?"));

  // A session that has ended is begun anew; what was typed comes back with the address.
  const signIn = (place, form) => {
    const fields = [...new FormData(form)].filter(([, value]) => typeof value === "string" && value !== "");
    window.location.assign(`/sign-in?next=${encodeURIComponent(`${place}?${new URLSearchParams(fields)}`)}`);
  };

  window.jointplay = { byId, make, addRow, mark, noAnswer, signIn };

  document.addEventListener("htmx:before:response", (event) => {
    const form = byId("confirm");
    if (!form || event.detail.ctx.response.status !== 401) return;
    event.preventDefault();
    signIn("/confirm", form);
  });

  document.addEventListener("htmx:after:swap", (event) => {
    mark();
    if (!["confirm", "browse"].includes(event.target.id)) return;
    const wrong = event.target.querySelector("[aria-invalid='true'], [data-wrong]");
    const result = byId("result");
    if (wrong) {
      wrong.focus();
    } else if (result.firstElementChild) {
      result.focus({ preventScroll: true });
      result.scrollIntoView({ block: "start" });
    }
  });
  document.addEventListener("htmx:error", noAnswer);
  // A whole page that came back with a refusal, from a form that is sent without a script.
  document.addEventListener("DOMContentLoaded", () => {
    mark();
    document.querySelector("main [aria-invalid='true'], main [data-wrong]")?.focus();
  });
})();
