// A recording, looked at: asks for what the form says, draws it, and asks for finer points where somebody looks closer.
"use strict";

(() => {
  const { colour, shade, drawChart, chartAt, addChartKind, byId, make } = window.jointplay;
  const figures = new Map();
  const VIEWS = ["spectrum", "waveform", "revolution", "spectrogram"];
  const DECIBELS = 20;
  let round = 0;

  const form = () => byId("look");
  const given = () => Object.fromEntries([...new FormData(form())].map(([name, value]) => [name, value.trim()]));
  const place = (view) => document.querySelector(`[data-signal="${view}"]`);
  // A rotation says its own unit, as the axis has that of the others.
  const named = (line, lines) => (line.unit === lines[0].unit ? line.name : `${line.name}, ${pretty(line.unit)}`);
  const pretty = (unit) => unit.replace("/s2", "/s²").replace(/^u/, "µ");

  const address = (key, view, look, more = {}) => {
    const asked = { view, unit: look.unit, of: look.of, ...more };
    for (const name of ["channel", "diagnosis", "speed"]) if (look[name]) asked[name] = look[name];
    if (["spectrum", "spectrogram", "matched"].includes(view)) asked.axis = look.axis;
    return `/api/v1/measurements/${encodeURIComponent(key)}/signal?${new URLSearchParams(asked)}`;
  };

  // Another recording of the machine turns at a speed of its own, which is found near that of the diagnosis.
  const beside = (look) => (look.diagnosis ? { ...look, speed: "" } : look);

  const fetched = async (url, signal) => {
    const answer = await fetch(url, { signal, headers: { Accept: "application/json" } });
    const found = await answer.json();
    if (!answer.ok) throw new Error(found.detail || "The service did not answer.");
    return found;
  };

  const points = (view) => Math.max(200, Math.round(place(view).clientWidth * (view === "waveform" ? 1 : 2)));
  const tone = (index) => colour(`--joint-${index % 6}`);
  const file = (view) => `${document.querySelector("h1").textContent.trim().replace(/\.[^.]*$/, "")}-${view}`;
  const axisOf = (found) => (found.axis_unit ? `${found.axis}, ${found.axis_unit}` : found.axis);

  // Samples between which nothing was left out are their own lowest and highest.
  const waves = (found) => {
    const lines = [];
    const names = [...new Set(found.lines.map((line) => line.name))];
    for (const [index, name] of names.entries()) {
      const own = Object.fromEntries(found.lines.filter((line) => line.name === name).map((line) => [line.kind, line]));
      const style = { stroke: tone(index), width: 1 };
      const { unit } = own.value || own.high;
      lines.push({ name: named({ name, unit }, found.lines), unit, values: (own.high || own.value).values, style });
      lines.push({ name: `${name}, lowest`, unit, silent: true, values: (own.low || own.value).values, style });
    }
    return { at: found.at, lines };
  };

  const waveform = (found, look, key) => {
    const wave = waves(found);
    return {
      ...wave,
      x: { name: "time", label: "time, s" },
      y: { label: pretty(found.lines[0].unit) },
      bands: wave.lines.map((_, index) => index).filter((index) => index % 2 === 0).map((index) => ({ series: [index + 1, index + 2], fill: `${wave.lines[index].style.stroke}55` })),
      refine: async (from, to, signal) => waves(await fetched(address(key, "waveform", look, { from: Math.max(0, from), to, points: 3 * points("waveform") }), signal)),
    };
  };

  const scaled = (values, look) => {
    if (look.levels === "lin") return values;
    return values.map((value) => (value > 0 ? (look.levels === "db" ? DECIBELS * Math.log10(value) : value) : null));
  };
  // What is laid over a spectrum: another recording, or machines of the catalogue, each in its own look.
  const LAID = {
    other: { dash: [4, 4], width: 1 },
    first: { colour: "--matched", dash: [6, 4], width: 2 },
    second: { colour: "--rival", dash: [2, 3], width: 2 },
    in_order: { colour: "--good", dash: [8, 3, 2, 3] },
  };
  const spectra = (answers, look) => {
    const [at, ...values] = uPlot.join(answers.map((found) => [found.at, ...found.lines.map((line) => scaled(line.values, look))]));
    const lines = answers.flatMap((found, which) => found.lines.map((line, index) => {
      const laid = line.kind === "value" ? which && "other" : line.kind;
      const { colour: own, ...style } = LAID[laid] || {};
      return {
        name: `${named(line, found.lines)}${laid ? `, ${laid.replace("_", " ")}` : ""}`, unit: look.levels === "db" ? `dB re 1 ${line.unit}` : line.unit,
        style: { stroke: own ? colour(own) : tone(index), spanGaps: true, ...style },
      };
    }));
    return { at, lines: lines.map((line, index) => ({ ...line, values: values[index] })) };
  };

  const spectrum = (found, look, key, more) => {
    const unit = pretty(found.lines[0].unit);
    const [other, laid] = more;
    return {
      ...spectra([found, other, laid].filter(Boolean), look),
      x: { name: found.axis, label: axisOf(found), first: found.axis === "order" && found.ends[1] > 60 ? [found.ends[0], 60] : null },
      y: { label: look.levels === "db" ? `dB re 1 ${unit}` : unit, log: look.levels === "log" },
      harmonic: look.harmonics === "drive" && found.drive_speed_rpm ? (found.axis === "order" ? 1 : found.drive_speed_rpm / 60) : null,
      paint: harmonics,
      refine: async (from, to, signal) => {
        const asked = { from: Math.max(0, from), to, points: points("spectrum") };
        const places = [address(key, "spectrum", look, asked), ...(other ? [address(look.with, "spectrum", beside(look), asked)] : [])];
        const answers = await Promise.all(places.map((each) => fetched(each, signal)));
        return spectra([...answers, ...(laid ? [laid] : [])], look);
      },
    };
  };

  // Multiples of an order, as far as there is room for them.
  const harmonics = ({ line, text, x, y }, chart, { harmonic }) => {
    const { min, max } = chart.scales.x;
    const { min: low, max: high } = chart.scales.y;
    const space = (chart.over.clientWidth * harmonic) / (max - min);
    if (!(space >= 4)) return;
    for (let number = Math.max(1, Math.ceil(min / harmonic)); number * harmonic <= max; number += 1) {
      const at = x(number * harmonic);
      line([[at, y(low)], [at, y(high)]], colour("--decided"), 1, number === 1 ? [] : [3, 3]);
      if (number % Math.ceil(22 / space) === 0 || number === 1) text(String(number), at, y(high) + 10, colour("--decided"), "center", "11px");
    }
  };

  // Everything by the angle of the drive has one axis.
  const byAngle = (found, lines, label) => ({
    at: found.at,
    lines,
    group: "angle",
    x: { name: "angle", label: "angle of the drive, °", range: [0, 360], values: (self, ticks) => ticks.map((tick) => `${tick}°`) },
    y: { label },
  });
  const revolution = (found) => {
    const several = new Set(found.lines.map((line) => line.name)).size > 1;
    const shown = found.lines.filter((line) => line.kind === "rms" || !several);
    const lines = shown.map((line, index) => ({ ...line, name: several ? named(line, shown) : `${line.name}, ${line.kind}`, style: { stroke: tone(index), width: line.kind === "rms" ? 2 : 1.5 } }));
    return byAngle(found, lines, `${pretty(found.lines[0].unit)}${several ? " rms" : ""}`);
  };
  const contact = (found) => byAngle(found, found.lines.map((line, index) => ({ ...line, style: { stroke: tone(index), width: 2 } })), "force, N");

  const picture = (map) => {
    const loudest = Math.max(...map.levels_db.map((row) => Math.max(...row)));
    const canvas = make("canvas", { width: map.levels_db[0].length, height: map.levels_db.length });
    const pen = canvas.getContext("2d");
    const image = pen.createImageData(canvas.width, canvas.height);
    for (const [row, levels] of map.levels_db.entries()) {
      for (const [column, level] of levels.entries()) {
        image.data.set([...shade(1 + (level - loudest) / 80), 255], 4 * ((canvas.height - 1 - row) * canvas.width + column));
      }
    }
    pen.putImageData(image, 0, 0);
    return canvas;
  };

  const spectrogram = (found, look, key) => {
    const { rows } = found.map;
    const half = (rows[1] - rows[0]) / 2 || 0.5;
    const [low, high] = [rows[0] - half, rows[rows.length - 1] + half];
    const unit = pretty(found.map.unit);
    const parts = (next) => ({ at: next.at, map: next.map, image: picture(next.map), lines: [{ name: next.lines[0].name, unit, values: next.at.map(() => null), style: { stroke: colour("--measured") } }],
      csv: { head: [axisOf(next), ...next.map.rows.map((row) => `${row} [dB re 1 ${next.map.unit}]`)], rows: next.at.map((at, column) => [at, ...next.map.levels_db.map((levels) => levels[column])]) } });
    return {
      ...parts(found),
      x: { name: found.axis, label: axisOf(found) },
      y: { label: found.axis === "revolution" ? "order of the drive" : "frequency, Hz", range: [low, high] },
      value: () => {
        const { chart, figure } = chartAt(place("spectrogram")) || {};
        const column = chart?.cursor.idx;
        if (column == null || chart.cursor.top < 0) return "–";
        const at = chart.posToVal(chart.cursor.top, "y");
        const row = Math.max(0, Math.min(rows.length - 1, Math.round((at - rows[0]) / (2 * half))));
        return `${figure.map.levels_db[row]?.[column]} dB at ${at.toPrecision(3)}`;
      },
      paint: ({ image, x, y }, chart, now) => {
        const step = now.at.length > 1 ? (now.at[1] - now.at[0]) / 2 : 0.5;
        const [left, top] = [x(now.at[0] - step), y(high)];
        image(now.image, left, top, x(now.at.at(-1) + step) - left, y(low) - top);
      },
      refine: async (from, to, signal) => parts(await fetched(address(key, "spectrogram", look, { from: Math.max(0, from), to }), signal)),
    };
  };

  const orbit = (found) => {
    const mean = (name) => found.lines.find((line) => line.name === name && line.kind === "mean");
    const [across, up] = [mean("x"), mean("y")];
    const reach = 1.1 * Math.max(...across.values.map(Math.abs), ...up.values.map(Math.abs));
    const unit = pretty(across.unit);
    const width = Math.min(place("orbit").clientWidth, 420);
    return {
      at: [-reach, reach],
      lines: [{ name: "path", values: [], style: { stroke: tone(0) } }],
      height: width,
      x: { name: "x", label: `x, ${unit}` },
      y: { label: `y, ${unit}`, range: [-reach, reach] },
      csv: { head: ["angle [deg]", `x [${across.unit}]`, `y [${up.unit}]`], rows: found.at.map((at, index) => [at, across.values[index], up.values[index]]) },
      paint: ({ line, x, y }) => line([...found.at.keys(), 0].map((index) => [x(across.values[index]), y(up.values[index])]), tone(0), 2),
    };
  };

  const noted = (view, notes) => {
    document.querySelector(`[data-note="${view}"]`).textContent = notes.map((each) => `${each[0].toUpperCase()}${each.slice(1)}.`).join(" ");
  };

  const FIGURES = { waveform, spectrum, revolution, spectrogram, contact };

  const draw = (view, figure) => {
    figure.title = byId(`title-${view}`).textContent;
    figure.file = file(view);
    figures.set(view, figure);
    drawChart(place(view), figure);
    place(view).dataset.points = figure.at.length;
    place(view).dataset.look = new URLSearchParams(given());
  };

  const show = async (view, look, mine) => {
    const key = form().dataset.measurement;
    document.querySelector(`[data-numbers="${view}"]`).href = address(key, view, look);
    const more = { points: view === "waveform" || view === "spectrum" ? points(view) : 1200 };
    const found = await fetched(address(key, view, look, more));
    const other = view === "spectrum" && look.with ? await fetched(address(look.with, view, beside(look), more)) : null;
    const laid = view === "spectrum" && look.diagnosis && look.channel ? await fetched(address(key, "matched", look)).catch((error) => ({ at: [], lines: [], notes: [error.message] })) : null;
    if (mine !== round) return;
    noted(view, [...found.notes, ...(laid?.notes || [])]);
    draw(view, FIGURES[view](found, look, key, [other, laid]));
    if (view !== "revolution") return;
    const path = look.of === "frame" && !look.channel;
    place("orbit").closest("section").hidden = !path;
    if (path) draw("orbit", orbit(found));
    else figures.delete("orbit");
  };

  const all = () => {
    const mine = round += 1;
    for (const option of document.querySelectorAll("#look-channel [data-of]")) {
      option.hidden = option.disabled = option.dataset.of !== byId("look-of").value;
      if (option.selected && option.disabled) byId("look-channel").value = "";
    }
    const look = given();
    if (look.axis === "order" && !look.speed) look.axis = "hz";
    history.replaceState(null, "", `?${new URLSearchParams(given())}`);
    byId("look-error").textContent = "";
    for (const view of VIEWS) {
      const without = view === "revolution" && !look.speed;
      place(view)?.closest("section").toggleAttribute("hidden", without);
      if (without || !place(view)) continue;
      show(view, look, mine).catch((error) => { if (mine === round) byId("look-error").textContent = error.message; });
    }
  };

  // Asked for by its own button, as it is simulated then.
  const simulate = async () => {
    const said = byId("contact-said");
    said.textContent = "Simulating…";
    place("contact").hidden = false;
    try {
      await show("contact", given(), round);
      said.textContent = "";
    } catch (error) {
      place("contact").hidden = true;
      said.textContent = error.message;
    }
  };

  const clicked = (event) => {
    if (event.target.id === "contact") simulate();
    const entry = chartAt(place("spectrum"));
    if (!entry || byId("look-harmonics").value !== "cursor" || !entry.place.contains(event.target)) return;
    entry.figure.harmonic = entry.first.harmonic = entry.chart.posToVal(entry.chart.cursor.left, "x");
    entry.chart.redraw(false);
  };

  addChartKind("[data-signal]", (where) => figures.get(where.dataset.signal));
  document.addEventListener("DOMContentLoaded", () => {
    if (!form()) return;
    form().addEventListener("change", all);
    form().addEventListener("submit", (event) => { event.preventDefault(); all(); });
    document.addEventListener("click", clicked);
    all();
  });
})();
