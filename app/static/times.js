// Moments come in UTC and are shown and typed in the reader's own time zone; what came stays as the tip.
"use strict";

(() => {
  const own = new Intl.DateTimeFormat("sv", { dateStyle: "short", timeStyle: "medium" });
  const spell = (moment) => own.format(moment).slice(0, 16).split(" ");
  const zoned = new Intl.DateTimeFormat("en", { timeZoneName: "short" });
  const zoneOf = (moment) => zoned.format(moment).split(", ")[1];
  const localize = (root = document) => {
    for (const place of root.querySelectorAll("time[datetime]:not([title])")) {
      const moment = new Date(place.dateTime);
      const [day, clock] = place.children;
      if (!clock || Number.isNaN(moment.getTime())) continue;
      place.title = `${place.dateTime.replace("T", " ").replace("Z", "")} UTC`;
      [day.textContent, clock.textContent] = spell(moment);
      if (!("bare" in place.dataset)) clock.textContent += ` ${zoneOf(moment)}`;
    }
    for (const option of root.querySelectorAll("option")) {
      option.textContent = option.textContent.replace(/(\d{4}-\d\d-\d\d) (\d\d:\d\d) UTC/, (all, day, clock) => {
        const moment = new Date(`${day}T${clock}Z`);
        return `${spell(moment).join(" ")} ${zoneOf(moment)}`;
      });
    }
    for (const place of root.querySelectorAll("[data-zone]")) place.textContent = Intl.DateTimeFormat().resolvedOptions().timeZone;
    for (const field of root.querySelectorAll("input[data-moment]")) {
      const before = new Date(field.dataset.moment);
      if (!field.value && !Number.isNaN(before.getTime())) field.value = own.format(before).replace(" ", "T");
    }
  };

  Object.assign(window.jointplay, { localize });
  // A moment is typed in the reader's own time zone, which is named beside it, and sent in UTC.
  document.addEventListener("formdata", (event) => {
    for (const { name, value } of event.target.querySelectorAll("input[type='datetime-local']")) {
      if (value) event.formData.set(name, new Date(value).toISOString());
    }
  });
  document.addEventListener("DOMContentLoaded", () => localize());
  document.addEventListener("htmx:after:swap", () => localize());
})();
