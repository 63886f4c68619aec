// The form: dropping a file, refusing one that is too large before it is sent, and where the eye goes afterwards.
// All listeners are the document's, because going back in the browser's history replaces the form.
"use strict";

(() => {
  const byId = (id) => document.getElementById(id);

  const mark = () => {
    for (const slot of document.querySelectorAll("#ask .error")) {
      const field = byId(slot.id.slice("error-".length));
      if (slot.textContent.trim()) {
        field.setAttribute("aria-invalid", "true");
        const folded = field.closest("details");
        if (folded) folded.open = true;
      } else {
        field.removeAttribute("aria-invalid");
      }
    }
  };

  const tooLarge = () => {
    const limit = Number(byId("ask").dataset.maxBytes);
    const files = byId("file").files;
    const size = files.length ? files[0].size : 0;
    const over = size > limit;
    const message = `the file has ${(size / 1e6).toFixed(1)} MB; this service takes at most ${limit / 1e6} MB`;
    byId("error-file").textContent = over ? message : "";
    mark();
    return over;
  };

  const sensors = () => {
    for (const text of document.querySelectorAll(".sensors")) {
      text.hidden = text.dataset.catalogue !== byId("catalogue").value;
    }
  };

  document.addEventListener("change", (event) => {
    if (event.target.id === "file") tooLarge();
    if (event.target.id === "catalogue") sensors();
  });

  const over = (event) => event.target.closest?.("#drop");
  for (const kind of ["dragenter", "dragover"]) {
    document.addEventListener(kind, (event) => {
      const drop = over(event);
      if (!drop) return;
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  document.addEventListener("dragleave", (event) => over(event)?.classList.remove("over"));
  document.addEventListener("drop", (event) => {
    const drop = over(event);
    if (!drop) return;
    event.preventDefault();
    drop.classList.remove("over");
    if (event.dataTransfer.files.length) {
      byId("file").files = event.dataTransfer.files;
      tooLarge();
    }
  });

  document.addEventListener("htmx:before:request", (event) => {
    if (event.target.id === "ask" && tooLarge()) event.preventDefault();
  });
  document.addEventListener("htmx:after:swap", (event) => {
    sensors();
    mark();
    if (event.target.id !== "ask") return;
    const wrong = document.querySelector("#ask [aria-invalid='true']");
    const result = byId("result");
    if (wrong) {
      wrong.focus();
    } else if (result.firstElementChild) {
      result.focus({ preventScroll: true });
      result.scrollIntoView({ block: "start" });
    }
  });
  document.addEventListener("htmx:error", () => {
    const card = document.createElement("div");
    card.className = "card refusal";
    card.setAttribute("role", "alert");
    card.textContent = "The service did not answer. Is it still running?";
    byId("result").replaceChildren(card);
  });
  document.addEventListener("DOMContentLoaded", sensors);
})();
