// An asset's past: clearance over time by joint with its interval, and marks for what has no clearance.
"use strict";

(() => {
  const SYMBOLS = { in_order: "✓", changed: "△", unknown: "?", finding: "◆", repair: "↺" };

  const { colour } = window.jointplay;

  // One column of times for all joints; a joint has no value at the times of others.
  const table = (data) => {
    const times = new Set(data.events.map((event) => event.at));
    for (const joint of data.joints) for (const point of joint.points) times.add(point.at);
    const sorted = [...times].sort((a, b) => a - b);
    const columns = data.joints.map((joint) => {
      const values = new Map(joint.points.map((point) => [point.at, point.um]));
      return sorted.map((time) => values.get(time) ?? null);
    });
    return [sorted, ...columns];
  };

  const largest = (data) => Math.max(1, ...data.joints.flatMap((joint) => joint.points.map((point) => point.high)),
    ...data.events.map((event) => event.um ?? 0));

  const range = (times) => {
    const first = times[0];
    const last = times[times.length - 1];
    const margin = Math.max(0.05 * (last - first), 1800);
    return [first - margin, last + margin];
  };

  // Intervals as bars; marks stand at their clearance, those without one at the bottom.
  const marks = (data) => ({ pen: ctx, scale, x: across, y: up }) => {
    ctx.save();
    for (const joint of data.joints) {
      ctx.strokeStyle = colour(`--joint-${joint.look}`);
      ctx.lineWidth = 2 * scale;
      for (const point of joint.points) {
        const x = across(point.at);
        const ends = [point.low, point.high].map(up);
        ctx.beginPath();
        ctx.moveTo(x, ends[0]);
        ctx.lineTo(x, ends[1]);
        for (const end of ends) {
          ctx.moveTo(x - 4 * scale, end);
          ctx.lineTo(x + 4 * scale, end);
        }
        ctx.stroke();
      }
    }
    ctx.font = `700 ${17 * scale}px ${getComputedStyle(document.body).fontFamily}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    for (const event of data.events) {
      const y = up(event.um ?? 0) - (event.um == null ? 9 * scale : 0);
      ctx.fillStyle = colour(`--mark-${event.kind.replace("_", "-")}`);
      const x = across(event.at);
      ctx.fillText(SYMBOLS[event.kind], x, y);
      if (event.joint) ctx.fillText(event.joint, x + 15 * scale, y);
    }
    ctx.restore();
  };

  const day = uPlot.fmtDate("{YYYY}-{MM}-{DD}");
  const clock = uPlot.fmtDate("{HH}:{mm}");
  const utc = (time) => uPlot.tzDate(new Date(time * 1000), "Etc/UTC");

  // Hours where a step is less than a day, with the date where it begins or changes.
  const dates = (self, ticks, axis, space, step) => ticks.map((tick, index) => {
    const date = day(utc(tick));
    if (step >= 86400) return `${date.slice(5)}\n${date.slice(0, 4)}`;
    return index && date === day(utc(ticks[index - 1])) ? clock(utc(tick)) : `${clock(utc(tick))}\n${date}`;
  });

  window.jointplay.addChartKind("[data-history]", (place) => {
    const data = JSON.parse(place.dataset.history);
    const [times, ...columns] = table(data);
    const top = 1.1 * largest(data);
    return {
      title: place.closest("section")?.querySelector("h2")?.textContent,
      height: Math.max(240, Math.min(340, place.clientWidth * 0.4)),
      x: {
        name: "time (UTC)", label: "time (UTC)", time: true, tzDate: utc, values: dates, value: "{YYYY}-{MM}-{DD} {HH}:{mm}",
        space: place.clientWidth > 480 ? 70 : 50, range: range(times),
      },
      y: { label: data.label, range: [0, top] },
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
