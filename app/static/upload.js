// Sending a recording: one that is too large is refused before it is sent, and how far it is can be seen.
// Without scripts the form is sent as any other.
"use strict";

(() => {
  const { addRow, byId, make } = window.jointplay;

  const tooLarge = () => {
    const limit = Number(byId("ask").dataset.maxBytes);
    const files = byId("file").files;
    const size = Math.max(0, ...[...files].map((file) => file.size));
    const over = size > limit;
    const message = `the file has ${(size / 1e6).toFixed(1)} MB; this service takes at most ${limit / 1e6} MB`;
    byId("error-file").textContent = over ? message : "";
    window.jointplay.mark();
    return over;
  };

  const waiting = (text) => {
    byId("submit").disabled = Boolean(text);
    byId("sending").hidden = !text;
    byId("sending-text").textContent = text;
  };

  const answered = (request) => {
    if (request.status === 401) {
      window.jointplay.signIn("/", byId("ask"));
      return;
    }
    const place = request.getResponseHeader("Location");
    if (place) {
      window.location.assign(place);
      return;
    }
    waiting("");
    const answer = new DOMParser().parseFromString(request.responseText, "text/html");
    for (const slot of answer.querySelectorAll(".error[id]")) {
      const own = byId(slot.id);
      if (own) own.textContent = slot.textContent;
    }
    const card = answer.querySelector(".refusal");
    byId("result").replaceChildren(...(card ? [card] : []));
    if (!card && !answer.querySelector(".error[id]")) window.jointplay.noAnswer();
    window.jointplay.mark();
    document.querySelector("#ask [aria-invalid='true']")?.focus();
  };

  const send = (form) => {
    const request = new XMLHttpRequest();
    request.open("POST", form.action);
    request.setRequestHeader("HX-Request", "true");
    request.upload.addEventListener("progress", (event) => {
      if (event.lengthComputable) byId("progress").value = event.loaded / event.total;
    });
    request.upload.addEventListener("load", () => {
      byId("progress").removeAttribute("value");
      byId("sending-text").textContent = "Reading the recording…";
    });
    request.addEventListener("load", () => answered(request));
    request.addEventListener("error", () => {
      waiting("");
      window.jointplay.noAnswer();
    });
    byId("progress").value = 0;
    byId("result").replaceChildren();
    waiting("Sending…");
    request.send(new FormData(form));
  };

  // Several files: each is diagnosed by itself, as understood, and has a row with a link to its result.
  const outcome = async (given, file) => {
    const form = new FormData();
    for (const [name, value] of given) if (value && !["file", "measured_at", "beside"].includes(name)) form.append(name, value);
    form.append("file", file);
    try {
      const answer = await fetch("/api/v1/diagnoses", { method: "POST", body: form });
      if (answer.status === 401) return window.jointplay.signIn("/", byId("ask"));
      const found = await answer.json();
      if (!answer.ok) return ["refused", found.detail];
      const { label, probability: sure } = found.hypotheses[0];
      const said = `${label}, ${sure < 0.995 ? Math.round(100 * sure) : "> 99"} %`;
      return [found.verdict.replace("_", " "), make("a", { href: `/diagnoses/${found.id}` }, said)];
    } catch {
      return ["refused", "the service gave no answer"];
    }
  };
  const sendEach = async (form) => {
    const given = [...new FormData(form)];
    const files = [...byId("file").files];
    const table = make("table");
    addRow(table.createTHead(), "col", ["File", "Verdict", "Most probable, or why it was refused"]);
    const rows = table.createTBody();
    byId("result").replaceChildren(make("section", { className: "card scroll", tabIndex: 0, id: "answers", "aria-label": "Results" }, table));
    byId("progress").value = 0;
    for (const [number, file] of files.entries()) {
      waiting(`${number} of ${files.length} files are answered…`);
      const found = await outcome(given, file);
      if (!found) return;
      addRow(rows, "row", [file.name, ...found]);
      byId("progress").value = (number + 1) / files.length;
    }
    waiting("");
  };

  document.addEventListener("submit", (event) => {
    if (event.target.id !== "ask") return;
    event.preventDefault();
    if (tooLarge()) return;
    if (byId("file").files.length > 1) sendEach(event.target);
    else send(event.target);
  });
  document.addEventListener("change", (event) => {
    if (event.target.id === "file") tooLarge();
  });
  // A page that comes back from the browser's own cache is as it was left: it waits for nothing any more.
  window.addEventListener("pageshow", () => {
    if (!byId("ask")) return;
    byId("file").multiple = true;
    waiting("");
  });

  for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      const place = event.target.closest?.("#drop");
      if (!place) return;
      event.preventDefault();
      place.classList.toggle("over", kind === "dragenter" || kind === "dragover");
      if (kind !== "drop" || !event.dataTransfer.files.length) return;
      byId("file").files = event.dataTransfer.files;
      tooLarge();
    });
  }
})();
