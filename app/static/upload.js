// Sending a recording: one that is too large is refused before it is sent, and how far it is can be seen.
// Without scripts the form is sent as any other.
"use strict";

(() => {
  const byId = (id) => document.getElementById(id);

  const tooLarge = () => {
    const limit = Number(byId("ask").dataset.maxBytes);
    const files = byId("file").files;
    const size = files.length ? files[0].size : 0;
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

  document.addEventListener("submit", (event) => {
    if (event.target.id !== "ask") return;
    event.preventDefault();
    if (!tooLarge()) send(event.target);
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
