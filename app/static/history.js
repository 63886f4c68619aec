// An asset's past: clearance over time by joint with its interval, and marks for what has no clearance.
"use strict";

(() => {
  const SYMBOLS = { in_order: "✓", changed: "△", unknown: "?", finding: "◆", repair: "↺" };

  const { colour } = window.jointplay;

  // One column of times for all joints; a joint has no value at the times of others.
  const table = (data) => uPlot.join([[data.events.map((event) => event.at)], ...data.joints.map(({ points }) => [points.map((point) => point.at), points.map((point) => point.um)])]);

  // Limits as lines; on them, when each is reached: bars from early to late, and the way there from the last recording.
  const limits = (data, { line, text, x, y }) => {
    const [begin, end] = data.ends;
    for (const { name, look, um, at } of data.reached) {
      const last = data.joints.find((joint) => joint.name === name).points.at(-1);
      const place = (time) => [x(Math.min(end, time ?? end)), y(um)];
      if (at[1] != null && at[1] <= end) line([[x(last.at), y(last.um)], place(at[1])], colour(`--joint-${look}`), 2, [2, 4]);
      line([place(at[0]), place(at[2])], colour(`--joint-${look}`), 6);
    }
    for (const limit of data.limits) {
      line([[x(begin), y(limit.um)], [x(end), y(limit.um)]], colour("--bad"), 2, [6, 4]);
      text(limit.text, x(limit.at), y(limit.um) - 5, colour("--bad"), "center");
    }
  };

  // Intervals as bars; marks stand at their clearance, those without one at the bottom.
  const marks = (data) => (brush) => {
    limits(data, brush);
    const { line, text, x, y } = brush;
    for (const joint of data.joints) {
      for (const point of joint.points) {
        const [at, low, high] = [x(point.at), y(point.low), y(point.high)];
        const cap = (side) => [[at - 4, side], [at + 4, side]];
        for (const each of [[[at, low], [at, high]], cap(low), cap(high)]) line(each, colour(`--joint-${joint.look}`), 2);
      }
    }
    for (const event of data.events) {
      const [at, top] = [x(event.at), y(event.um ?? 0) + (event.um == null ? -3 : 6)];
      const fill = colour(`--mark-${event.kind.replace("_", "-")}`);
      text(SYMBOLS[event.kind], at, top, fill, "center", "700 17px");
      if (event.joint) text(event.joint, at + 15, top, fill, "center", "700 17px");
    }
  };

  const local = (time) => new Date(time * 1000);
  // Hours where a step is less than a day, with the date where it begins or changes.
  const NONE = [null, null, null];
  const DATES = [
    [86400, "{MM}-{DD}\n{YYYY}", ...NONE, ...NONE, 1],
    [1, "{HH}:{mm}", ...Array(3).fill("\n{YYYY}-{MM}-{DD}"), ...NONE, 1],
  ];

  window.jointplay.addChartKind("[data-history]", (place) => {
    const data = JSON.parse(place.dataset.history);
    const [times, ...columns] = table(data);
    return {
      title: place.closest("section")?.querySelector("h2")?.textContent,
      height: Math.max(240, Math.min(340, place.clientWidth * 0.4)),
      x: {
        name: "time", label: "time", time: true, tzDate: local, values: DATES, value: "{YYYY}-{MM}-{DD} {HH}:{mm}",
        space: place.clientWidth > 480 ? 70 : 50, range: data.ends,
      },
      y: { label: data.label, range: [0, data.top] },
      value: (value) => (value == null ? "–" : `${value.toFixed(0)} µm`),
      at: times,
      lines: data.joints.map((joint, index) => ({
        name: `joint ${joint.name}`, unit: "µm", values: columns[index],
        style: { stroke: colour(`--joint-${joint.look}`), width: 2, spanGaps: true, dash: joint.look % 2 ? [6, 4] : undefined, points: { show: true, size: 8 } },
      })),
      paint: marks(data),
    };
  });
})();
