// Sending a recording: one that is too large is refused before it is sent, and how far it is can be seen.
// Without scripts the form is sent as any other.
"use strict";

(() => {
  const byId = (id) => document.getElementById(id);

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

  // Several files: each is diagnosed by itself, as it is understood, and has a row with a link to its result.
  const cells = (row, head, texts) => {
    for (const text of texts) {
      const cell = document.createElement(head || !row.children.length ? "th" : "td");
      cell.scope = head ? "col" : "row";
      cell.append(text);
      row.append(cell);
    }
    return row;
  };
  const outcome = async (given, file) => {
    const form = new FormData();
    for (const [name, value] of given) if (name !== "file" && name !== "measured_at" && value) form.append(name, value);
    form.append("file", file);
    try {
      const answer = await fetch("/api/v1/diagnoses", { method: "POST", body: form });
      if (answer.status === 401) return window.jointplay.signIn("/", byId("ask"));
      const found = await answer.json();
      if (!answer.ok) return ["refused", found.detail];
      const [first] = found.hypotheses;
      const link = Object.assign(document.createElement("a"), { href: `/diagnoses/${found.id}` });
      link.textContent = `${Object.keys(first.joints).join(" + ") || "none worn"}, ${Math.floor(100 * first.probability)} %`;
      return [found.verdict.replace("_", " "), link];
    } catch {
      return ["refused", "the service gave no answer"];
    }
  };
  const sendEach = async (form) => {
    const given = [...new FormData(form)];
    const files = [...byId("file").files];
    const table = document.createElement("table");
    cells(table.createTHead().insertRow(), true, ["File", "Verdict", "Most probable, or why it was refused"]);
    const rows = table.createTBody();
    const card = Object.assign(document.createElement("section"), { className: "card scroll", tabIndex: 0, id: "answers" });
    card.setAttribute("aria-label", "Results");
    card.append(table);
    byId("result").replaceChildren(card);
    byId("progress").value = 0;
    for (const [number, file] of files.entries()) {
      waiting(`${number} of ${files.length} files are answered…`);
      const found = await outcome(given, file);
      if (!found) return;
      cells(rows.insertRow(), false, [file.name, ...found]);
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
  // A moment is typed in the reader's own time zone, which is named beside it, and sent in UTC.
  const local = (moment) => new Date(moment - moment.getTimezoneOffset() * 60000).toISOString().slice(0, 19);
  document.addEventListener("formdata", (event) => {
    const typed = event.target.id === "ask" && event.formData.get("measured_at");
    if (typed) event.formData.set("measured_at", new Date(typed).toISOString());
  });
  // A page that comes back from the browser's own cache is as it was left: it waits for nothing any more.
  window.addEventListener("pageshow", () => {
    if (!byId("ask")) return;
    byId("file").multiple = true;
    waiting("");
    const field = byId("measured_at");
    byId("zone").textContent = Intl.DateTimeFormat().resolvedOptions().timeZone;
    const before = new Date(field.dataset.moment);
    if (!field.value && !Number.isNaN(before.getTime())) field.value = local(before);
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
})();
