// An asset's past: clearance over time by joint with its interval, and marks for what has no clearance.
"use strict";

(() => {
  const drawn = new Map();
  const SYMBOLS = { in_order: "✓", changed: "△", unknown: "?", finding: "◆", repair: "↺" };

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

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
  const limits = (chart, data, scale) => {
    const { ctx, bbox } = chart;
    const line = (look, dash, points) => {
      ctx.strokeStyle = colour(look);
      ctx.setLineDash(dash.map((length) => length * scale));
      ctx.beginPath();
      for (const [x, y] of points) ctx.lineTo(x, y);
      ctx.stroke();
    };
    ctx.save();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = `${12 * scale}px ${getComputedStyle(document.body).fontFamily}`;
    ctx.textAlign = "left";
    ctx.textBaseline = "bottom";
    ctx.fillStyle = colour("--bad");
    ctx.lineWidth = 2 * scale;
    for (const { name, look, um, at } of data.reached ?? []) {
      const points = data.joints.find((joint) => joint.name === name).points;
      const last = points[points.length - 1];
      const y = chart.valToPos(um, "y", true);
      const place = (time) => (time == null ? bbox.left + bbox.width : chart.valToPos(time, "x", true));
      if (at[1] != null) line(`--joint-${look}`, [2, 4], [[place(last.at), chart.valToPos(last.um, "y", true)], [place(at[1]), y]]);
      ctx.lineWidth = 6 * scale;
      line(`--joint-${look}`, [], [[place(at[0]), y], [place(at[2]), y]]);
      ctx.lineWidth = 2 * scale;
    }
    for (const limit of data.limits ?? []) {
      const y = Math.round(chart.valToPos(limit.um, "y", true));
      line("--bad", [6, 4], [[bbox.left, y], [bbox.left + bbox.width, y]]);
      ctx.fillText(limit.text, bbox.left + 6 * scale, y - 3 * scale);
    }
    ctx.restore();
  };

  // Intervals as bars; marks stand at their clearance, those without one at the bottom.
  const marks = (data) => (chart) => {
    const { ctx } = chart;
    const scale = window.devicePixelRatio || 1;
    limits(chart, data, scale);
    ctx.save();
    for (const joint of data.joints) {
      ctx.strokeStyle = colour(`--joint-${joint.look}`);
      ctx.lineWidth = 2 * scale;
      for (const point of joint.points) {
        const x = chart.valToPos(point.at, "x", true);
        const ends = [point.low, point.high].map((value) => chart.valToPos(value, "y", true));
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
      const y = chart.valToPos(event.um ?? 0, "y", true) - (event.um == null ? 9 * scale : 0);
      ctx.fillStyle = colour(`--mark-${event.kind.replace("_", "-")}`);
      const x = chart.valToPos(event.at, "x", true);
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

  const draw = (place) => {
    const data = JSON.parse(place.dataset.history);
    const values = table(data);
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
    const um = (self, value) => (value == null ? "–" : `${value.toFixed(0)} µm`);
    const width = place.clientWidth;
    drawn.get(place)?.destroy();
    place.replaceChildren();
    drawn.set(place, new uPlot({
      width,
      height: Math.max(240, Math.min(340, width * 0.4)),
      tzDate: utc,
      scales: { x: { range: range(values[0], data) }, y: { range: [0, 1.1 * largest(data)] } },
      axes: [{ ...axis, label: "time (UTC)", values: dates, space: width > 480 ? 70 : 50 }, { ...axis, label: data.label, size: 55 }],
      series: [
        { label: "time (UTC)", value: "{YYYY}-{MM}-{DD} {HH}:{mm}" },
        ...data.joints.map((joint) => ({
          label: `joint ${joint.name}`, value: um, stroke: colour(`--joint-${joint.look}`), width: 2, spanGaps: true,
          dash: joint.look % 2 ? [6, 4] : undefined, points: { show: true, size: 8 },
        })),
      ],
      legend: { show: width > 480 },
      hooks: { draw: [marks(data)] },
    }, values, place));
  };

  const drawAll = () => {
    for (const place of document.querySelectorAll("[data-history]")) draw(place);
  };

  let width = 0;
  const resized = () => {
    if (document.documentElement.clientWidth === width) return;
    width = document.documentElement.clientWidth;
    drawAll();
  };

  document.addEventListener("DOMContentLoaded", resized);
  document.addEventListener("htmx:after:swap", drawAll);
  window.addEventListener("resize", resized);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
})();
