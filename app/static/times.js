// Moments come in UTC and are shown in the reader's own time zone; what came stays as the tip.
"use strict";

(() => {
  const two = (number) => String(number).padStart(2, "0");
  const spell = (moment) => [
    `${moment.getFullYear()}-${two(moment.getMonth() + 1)}-${two(moment.getDate())}`,
    `${two(moment.getHours())}:${two(moment.getMinutes())}`,
  ];
  const zoneOf = (moment) =>
    new Intl.DateTimeFormat("en", { timeZoneName: "short" }).formatToParts(moment).find((part) => part.type === "timeZoneName").value;
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
  };

  Object.assign(window.jointplay, { localize });
  document.addEventListener("DOMContentLoaded", () => localize());
  document.addEventListener("htmx:after:swap", () => localize());
})();
