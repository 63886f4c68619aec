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
    ...data.events.map((event) => event.um ?? 0), ...(data.limits ?? []).map((limit) => limit.um));

  // As far ahead as a limit is foretold, but no further than the past reaches back.
  const range = (times, data) => {
    const first = times[0];
    const now = times[times.length - 1];
    const ahead = Math.max(now - first, 60 * 86400);
    const last = Math.min(now + ahead, Math.max(now, ...(data.reached ?? []).map(({ at }) => at[2] ?? now + ahead)));
    const margin = Math.max(0.05 * (last - first), 1800);
    return [first - margin, last + margin];
  };

  // Limits as lines; on them, when each is reached: bars from early to late, and the way there from the last recording.
  const limits = (data, [begin, end], { pen: ctx, scale, x: across, y: up }) => {
    const line = (look, dash, points) => {
      ctx.strokeStyle = colour(look);
      ctx.setLineDash(dash.map((length) => length * scale));
      ctx.beginPath();
      points.forEach(([x, y], index) => (index ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
      ctx.stroke();
      ctx.setLineDash([]);
    };
    ctx.font = `${12 * scale}px ${getComputedStyle(document.body).fontFamily}`;
    ctx.textAlign = "left";
    ctx.textBaseline = "bottom";
    ctx.fillStyle = colour("--bad");
    ctx.lineWidth = 2 * scale;
    for (const { name, look, um, at } of data.reached ?? []) {
      const points = data.joints.find((joint) => joint.name === name).points;
      const last = points[points.length - 1];
      const place = (time) => across(Math.min(end, time ?? end));
      if (at[1] != null && at[1] <= end) line(`--joint-${look}`, [2, 4], [[across(last.at), up(last.um)], [place(at[1]), up(um)]]);
      ctx.lineWidth = 6 * scale;
      line(`--joint-${look}`, [], [[place(at[0]), up(um)], [place(at[2]), up(um)]]);
      ctx.lineWidth = 2 * scale;
    }
    for (const limit of data.limits ?? []) {
      line("--bad", [6, 4], [[across(begin), up(limit.um)], [across(end), up(limit.um)]]);
      ctx.fillText(limit.text, across(begin) + 6 * scale, up(limit.um) - 3 * scale);
    }
  };

  // Intervals as bars; marks stand at their clearance, those without one at the bottom.
  const marks = (data, ends) => (strokes) => {
    const { pen: ctx, scale, x: across, y: up } = strokes;
    ctx.save();
    limits(data, ends, strokes);
    ctx.restore();
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
  const local = (time) => new Date(time * 1000);

  // Hours where a step is less than a day, with the date where it begins or changes.
  const dates = (self, ticks, axis, space, step) => ticks.map((tick, index) => {
    const date = day(local(tick));
    if (step >= 86400) return `${date.slice(5)}\n${date.slice(0, 4)}`;
    return index && date === day(local(ticks[index - 1])) ? clock(local(tick)) : `${clock(local(tick))}\n${date}`;
  });

  window.jointplay.addChartKind("[data-history]", (place) => {
    const data = JSON.parse(place.dataset.history);
    const [times, ...columns] = table(data);
    const top = 1.1 * largest(data);
    const ends = range(times, data);
    return {
      title: place.closest("section")?.querySelector("h2")?.textContent,
      height: Math.max(240, Math.min(340, place.clientWidth * 0.4)),
      x: {
        name: "time", label: "time", time: true, tzDate: local, values: dates, value: "{YYYY}-{MM}-{DD} {HH}:{mm}",
        space: place.clientWidth > 480 ? 70 : 50, range: ends,
      },
      y: { label: data.label, range: [0, top] },
      value: (value) => (value == null ? "–" : `${value.toFixed(0)} µm`),
      at: times,
      lines: data.joints.map((joint, index) => ({
        name: `joint ${joint.name}`, unit: "µm", values: columns[index],
        style: { stroke: colour(`--joint-${joint.look}`), width: 2, spanGaps: true, dash: joint.look % 2 ? [6, 4] : undefined, points: { show: true, size: 8 } },
      })),
      paint: marks(data, ends),
    };
  });
})();
