// The one chart of all pages: lines over an axis, with zoom, coupled cursors, a read-out for touch and keys, and files.
// A kind of chart says what is drawn in a place: { x, y, at, lines, bands, paint, group, file, refine, value }.
"use strict";

(() => {
  const { make } = window.jointplay;
  const kinds = [];
  const drawn = new Map();
  const READ_OUT = 80;
  const LOG = { distr: 3, log: 10 };

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const plain = (value) => (value == null ? "–" : tick(value, 4));

  // What figures paint with over their lines, in CSS pixels: on a canvas here, into a file by chart-files.js.
  const paint = (figure, chart) => {
    const { ctx: pen, bbox } = chart;
    const scale = window.devicePixelRatio || 1;
    const font = getComputedStyle(document.body).fontFamily;
    const at = (axis) => (value) => chart.valToPos(value, axis, true) / scale;
    pen.save();
    pen.beginPath();
    pen.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    pen.clip();
    pen.scale(scale, scale);
    pen.imageSmoothingEnabled = false;
    figure.paint({
      x: at("x"),
      y: at("y"),
      line: (points, stroke, width = 1, dash = []) => {
        Object.assign(pen, { strokeStyle: stroke, lineWidth: width }).setLineDash(dash);
        pen.beginPath();
        for (const point of points) pen.lineTo(...point);
        pen.stroke();
      },
      text: (said, left, top, fill, anchor = "start", size = "12px") => {
        Object.assign(pen, { fillStyle: fill, textAlign: anchor, textBaseline: "alphabetic", font: `${size} ${font}` }).fillText(said, left, top);
      },
      image: (...picture) => pen.drawImage(...picture),
    }, chart, figure);
    pen.restore();
  };
  const tick = (value, digits) => (value == null ? "" : String(Number(value.toPrecision(digits))));

  const options = (entry, width) => {
    const { figure } = entry;
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
    const value = figure.value || plain;
    const inGroup = figure.group ? { key: figure.group, scales: ["x", null], filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" } } : undefined;
    return {
      width,
      height: figure.height || Math.max(220, Math.min(320, width * 0.45)),
      tzDate: figure.x.tzDate,
      // A range that were fixed would forbid every zoom.
      scales: {
        x: { time: Boolean(figure.x.time), ...(figure.x.log && LOG), range: (self, low, high) => (entry.whole && low <= entry.ends[0] && high >= entry.ends[1] ? entry.whole : [low, high]) },
        y: { ...(figure.y.log && LOG), ...(figure.y.range && { range: figure.y.range }) },
      },
      axes: [
        { ...axis, size: figure.x.time ? 50 : 36, labelSize: 22, label: figure.x.label, ...(figure.x.space && { space: figure.x.space }), values: figure.x.values || ((self, ticks) => ticks.map((value) => tick(value, 8))) },
        { ...axis, label: figure.y.label, size: width > 480 ? 60 : 46, labelSize: 22, ...(figure.y.log ? { values: (self, ticks) => ticks.map((value) => (value && value < 1e-3 ? value.toExponential(0) : tick(value, 2))) } : {}) },
      ],
      series: [
        { label: figure.x.name, value: figure.x.value || ((self, at) => plain(at)) },
        ...figure.lines.map((line) => ({ width: 1.5, points: { show: false }, ...line.style, class: line.silent ? "silent" : undefined, label: line.name, value: (self, each) => value(each, line) })),
      ],
      bands: figure.bands,
      cursor: {
        sync: inGroup,
        drag: { x: true, y: false, setScale: true },
        bind: {
          dblclick: () => () => reset(entry),
          // The browser's echo of a touch comes late.
          mousemove: (self, over, read) => (event) => event.sourceCapabilities?.firesTouchEvents || read(event),
        },
      },
      legend: { show: true },
      hooks: {
        draw: [(chart) => figure.paint && paint(figure, chart)],
        setScale: [(chart, key) => key === "x" && moved(entry)],
      },
    };
  };

  const table = (figure) => [figure.at, ...figure.lines.map((line) => line.values)];
  const shown = (entry) => [entry.chart.scales.x.min, entry.chart.scales.x.max];
  const along = (entry, part) => {
    const [low, high] = shown(entry);
    return entry.figure.x.log ? low * (high / low) ** part : low + part * (high - low);
  };

  // The part of the axis that is shown, never beyond its ends.
  const show = (entry, low, high) => {
    const [first, last] = entry.whole;
    const [to, back] = entry.figure.x.log ? [Math.log, Math.exp] : [Number, Number];
    const width = Math.min(to(high) - to(low), to(last) - to(first));
    const from = Math.max(to(first), Math.min(to(low), to(last) - width));
    entry.chart.setScale("x", { min: Math.max(first, back(from)), max: Math.min(last, back(from + width)) });
  };
  const reset = ({ chart, whole: [min, max] }) => chart.setScale("x", { min, max });
  const zoom = (entry, factor) => show(entry, along(entry, 0.5 - 0.5 * factor), along(entry, 0.5 + 0.5 * factor));
  const pan = (entry, part) => show(entry, along(entry, part), along(entry, 1 + part));

  // After a zoom, charts of the same group follow, and finer points are asked for where there are any.
  const moved = (entry) => {
    const [low, high] = shown(entry);
    if (low === entry.window[0] && high === entry.window[1]) return;
    entry.window = [low, high];
    Object.assign(entry.place.dataset, { from: low, to: high });
    if (!entry.ready) return;
    for (const other of drawn.values()) {
      if (!entry.figure.group || other.figure.group !== entry.figure.group) continue;
      const [first, last] = shown(other);
      if (first !== low || last !== high) other.chart.setScale("x", { min: low, max: high });
    }
    if (entry.figure.refine) refine(entry);
  };

  const refine = (entry) => {
    clearTimeout(entry.waiting);
    entry.asked?.abort();
    entry.waiting = setTimeout(async () => {
      const [low, high] = entry.window;
      const [first, last] = entry.whole;
      entry.asked = new AbortController();
      // A screen more to either side, for a pan to show at once.
      const wider = [Math.max(first, 2 * low - high), Math.min(last, 2 * high - low)];
      try {
        const finer = low <= first && high >= last ? entry.first : await entry.figure.refine(...wider, entry.asked.signal);
        entry.chart.batch(() => {
          Object.assign(entry.figure, finer);
          entry.chart.setData(table(entry.figure), false);
          entry.chart.setScale("x", { min: low, max: high });
        });
        entry.place.dataset.points = entry.figure.at.length;
      } catch (error) {
        if (error.name !== "AbortError") throw error;
      }
    }, READ_OUT);
  };

  const move = (entry, index) => {
    const { chart } = entry;
    const [low, high] = chart.series[0].idxs;
    const at = Math.max(low, Math.min(high, index));
    entry.read = at;
    chart.setCursor({ left: chart.valToPos(chart.data[0][at], "x"), top: chart.over.clientHeight / 2 });
    entry.said.textContent = chart.series.map((line, number) => {
      const value = chart.data[number][at];
      if (number && entry.figure.lines[number - 1].silent) return "";
      return `${line.label} ${number ? line.value(chart, value) : line.value(chart, value, 0, at)}`;
    }).filter(Boolean).join(", ");
  };

  const KEYS = {
    ArrowLeft: (entry, at) => move(entry, at - 1),
    ArrowRight: (entry, at) => move(entry, at + 1),
    PageUp: (entry, at) => move(entry, at - 20),
    PageDown: (entry, at) => move(entry, at + 20),
    Home: (entry) => move(entry, 0),
    End: (entry) => move(entry, Infinity),
    "+": (entry) => zoom(entry, 0.5),
    "-": (entry) => zoom(entry, 2),
    "<": (entry) => pan(entry, -0.5),
    ">": (entry) => pan(entry, 0.5),
    0: reset,
  };
  const pressed = (place, event) => {
    const entry = drawn.get(place);
    if (!entry || !KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const [low, high] = entry.chart.series[0].idxs;
    KEYS[event.key](entry, entry.chart.cursor.idx ?? entry.read ?? Math.round((low + high) / 2));
  };

  // One finger reads out, two zoom and pan; upwards and downwards the page moves as ever.
  const touching = (entry) => {
    const { over } = entry.chart;
    const fingers = new Map();
    let pinch = null;
    const touched = (event) => {
      if (event.pointerType !== "touch") return;
      if (event.type !== "pointerdown" && !fingers.has(event.pointerId)) return;
      fingers.set(event.pointerId, event.offsetX);
      const spots = [...fingers.values()].sort((a, b) => a - b);
      if (spots.length === 1) {
        entry.chart.setCursor({ left: spots[0], top: over.clientHeight / 2 }, true, true);
      } else if (!pinch || event.type === "pointerdown") {
        pinch = spots.map((spot) => along(entry, spot / over.clientWidth));
      } else if (spots[1] - spots[0] > 10) {
        const per = (pinch[1] - pinch[0]) / (spots[1] - spots[0]);
        show(entry, pinch[0] - spots[0] * per, pinch[0] + (over.clientWidth - spots[0]) * per);
      }
    };
    const lifted = (event) => {
      fingers.delete(event.pointerId);
      pinch = null;
    };
    for (const kind of ["pointerdown", "pointermove"]) over.addEventListener(kind, touched);
    for (const kind of ["pointerup", "pointercancel"]) over.addEventListener(kind, lifted);
  };

  const TOOLS = [
    ["+", "Zoom in", KEYS["+"]],
    ["−", "Zoom out", KEYS["-"]],
    ["◀", "Back", KEYS["<"]],
    ["▶", "Forth", KEYS[">"]],
    ["All", "All of the axis", reset],
    ...["PNG", "SVG", "CSV"].map((kind) => [kind, `Download as ${kind}`, (now) => window.jointplay.saveChart(now, kind.toLowerCase())]),
  ];
  const tools = (entry) => {
    entry.said = make("span", { className: "unseen", role: "status" });
    const buttons = TOOLS.map(([text, title, act]) => make("button", {
      type: "button", className: "second", title, "aria-label": `${title}: ${entry.figure.title || "chart"}`, onclick: () => act(drawn.get(entry.place)),
    }, text));
    return make("div", { className: "chart-tools" }, ...buttons, entry.said);
  };

  const draw = (place, figure) => {
    const before = drawn.get(place);
    before?.chart.destroy();
    clearTimeout(before?.waiting);
    before?.asked?.abort();
    // The same drawn anew is looked at as closely.
    const part = before?.ready && before.first === figure ? before.window : figure.x.first;
    place.replaceChildren();
    const ends = [figure.at[0], figure.at.at(-1)];
    const entry = { place, figure: { ...figure }, ends, whole: figure.x.range || ends, window: [], first: figure, bar: before?.bar, said: before?.said };
    drawn.set(place, entry);
    entry.chart = new uPlot(options(entry, place.clientWidth), table(figure), place);
    if (!before) {
      entry.bar = tools(entry);
      place.tabIndex = 0;
      place.addEventListener("keydown", (event) => pressed(place, event));
    }
    place.after(entry.bar);
    touching(entry);
    queueMicrotask(() => {
      entry.window = shown(entry);
      entry.ready = true;
      if (part) show(entry, ...part);
    });
    return entry;
  };

  const drawAll = () => {
    for (const [place, entry] of drawn) {
      if (place.isConnected) continue;
      entry.chart.destroy();
      drawn.delete(place);
    }
    for (const [selector, figureOf] of kinds) {
      for (const place of document.querySelectorAll(selector)) {
        const figure = figureOf(place);
        if (figure) draw(place, figure);
      }
    }
  };

  let width = 0;
  const resized = () => {
    const now = document.documentElement.clientWidth;
    if (now === width) return;
    width = now;
    drawAll();
  };

  Object.assign(window.jointplay, {
    colour,
    drawChart: draw,
    shade: (share) => shade(share),
    chartAt: (place) => drawn.get(place),
    // Charts of a kind are drawn anew when they come, and when the screen's width or colours change.
    addChartKind: (selector, figureOf) => kinds.push([selector, figureOf]),
  });

  document.addEventListener("DOMContentLoaded", resized);
  document.addEventListener("htmx:after:swap", drawAll);
  window.addEventListener("resize", resized);
  const dark = window.matchMedia("screen and (prefers-color-scheme: dark)");
  dark.addEventListener("change", drawAll);  // paper is light, too

  // Members of a family, share 0 to 1, go from dark to light on light pages and the other way on dark ones.
  const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  const shade = (share) => {
    const at = Math.min(STOPS.length - 1.001, Math.max(0, share * (STOPS.length - 1)));
    const low = Math.floor(at);
    return STOPS[low].map((value, index) => Math.round(value + (at - low) * (STOPS[low + 1][index] - value)));
  };
  const member = (share) => `rgb(${shade(dark.matches ? 1 - 0.75 * share : 0.85 * share).join(" ")})`;

  // Levels by order: a few lines, and the range in which the first of them may lie.
  const LOOKS = {
    matched: { width: 2, dash: [6, 4] },
    rival: { dash: [2, 3] },
    measured: { width: 2, points: { show: true, size: 5 } },
    decided: { paths: () => null, points: { show: true, size: 12, width: 2.5, fill: "transparent" } },
  };
  window.jointplay.addChartKind("[data-chart]", (place) => {
    const data = JSON.parse(place.dataset.chart);
    const hidden = { stroke: "transparent" };
    return {
      group: "order",
      title: place.closest("figure")?.querySelector("figcaption")?.textContent,
      x: { name: "order", label: "order of the drive", log: true },
      y: { label: data.label },
      value: (value) => (value == null ? "–" : `${value.toFixed(1)} dB`),
      at: data.orders,
      lines: [
        { name: "scatter, upper", values: data.upper, style: hidden, silent: true },
        { name: "scatter, lower", values: data.lower, style: hidden, silent: true },
        ...data.lines.map((line) => ({ name: line.name, values: line.levels, silent: line.look === "decided", style: { ...(LOOKS[line.look] || { width: 1.5 }), stroke: line.share == null ? colour(`--${line.look}`) : member(line.share) } })),
      ],
      bands: [{ series: [1, 2], fill: colour("--scatter") }],
    };
  });
})();
