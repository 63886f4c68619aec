// The text of a machine beside its drawing: numbers of lines, the one at fault marked, a file read into the text.
// What is made of the text comes from the service; what was right last stays while something is wrong.
"use strict";

(() => {
  const { byId, make } = window.jointplay;
  const text = () => byId("text");
  const gutter = () => document.querySelector(".editor .gutter");

  const number = () => {
    if (!text() || !gutter()) return;
    const wrong = Number(document.querySelector("#told [data-line]")?.dataset.line);
    const lines = text().value.split("\n").map((_, index) => make("span", { className: index + 1 === wrong ? "wrong" : "" }, index + 1));
    gutter().replaceChildren(...lines);
    gutter().scrollTop = text().scrollTop;
    const told = document.querySelector("#told .refused");
    byId("drawing").classList.toggle("old", told?.dataset.drawn === "no");
    byId("account").classList.toggle("old", Boolean(told));
  };

  // Who clicks on the message is led to its line.
  const lead = (line) => {
    const before = text().value.split("\n").slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    const end = text().value.indexOf("\n", before);
    text().focus();
    text().setSelectionRange(before, end < 0 ? text().value.length : end);
    text().scrollTop = Math.max(0, (line - 6) * parseFloat(getComputedStyle(text()).lineHeight));
  };

  document.addEventListener("input", (event) => {
    if (event.target.id === "text") number();
  });
  document.addEventListener("scroll", (event) => {
    if (event.target.id === "text") gutter().scrollTop = event.target.scrollTop;
  }, true);
  document.addEventListener("click", (event) => {
    const told = event.target.closest?.("#told [data-line]");
    if (told) lead(Number(told.dataset.line));
  });
  document.addEventListener("change", async (event) => {
    if (event.target.id !== "load" || !event.target.files.length) return;
    text().value = await event.target.files[0].text();
    text().dispatchEvent(new Event("input", { bubbles: true }));
  });
  document.addEventListener("htmx:after:swap", number);
  window.addEventListener("pageshow", number);
})();
