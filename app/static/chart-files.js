// Charts as files: CSV of the numbers, PNG of the canvas, SVG drawn anew from the same lines.
"use strict";

(() => {
  const { colour, make } = window.jointplay;
  const escaped = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
  const HEAD = 40;

  const csv = ({ figure }) => {
    const cell = (value) => (/[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value ?? "");
    const { head, rows } = figure.csv || {
      head: [figure.x.label, ...figure.lines.map((line) => `${line.name} [${line.unit || figure.y.label}]`)],
      rows: figure.at.map((at, row) => [at, ...figure.lines.map((line) => line.values[row])]),
    };
    return new Blob([head, ...rows].map((row) => `${row.map(cell).join(",")}\r\n`), { type: "text/csv" });
  };

  const named = ({ chart, figure }) => chart.series.slice(1)
    .map((series, index) => ({ name: `— ${series.label}`, stroke: series._stroke || series.stroke(chart), line: figure.lines[index], show: series.show }))
    .filter((each) => each.show && !each.line.silent && each.stroke !== "transparent");

  const png = (entry) => new Promise((resolve) => {
    const source = entry.chart.ctx.canvas;
    const scale = window.devicePixelRatio || 1;
    const canvas = make("canvas", { width: source.width, height: source.height + HEAD * scale });
    const pen = canvas.getContext("2d");
    pen.fillStyle = colour("--card");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(source, 0, HEAD * scale);
    pen.scale(scale, scale);
    pen.font = "13px system-ui, sans-serif";
    pen.fillStyle = colour("--text");
    pen.fillText(entry.figure.title || "", 8, 16);
    let left = 8;
    for (const { name, stroke } of named(entry)) {
      pen.fillStyle = stroke;
      pen.fillText(name, left, 34);
      left += pen.measureText(`${name}   `).width;
    }
    canvas.toBlob(resolve, "image/png");
  });

  // What figures paint with, written down as SVG.
  const scribe = (out, x, y) => ({
    x,
    y,
    line: (points, stroke, width = 1, dash = []) => out.push(`<path d="M${points.map((point) => point.map((value) => value.toFixed(2)).join(" ")).join("L")}" fill="none" stroke="${stroke}" stroke-width="${width}" stroke-dasharray="${dash.join(" ")}"/>`),
    text: (said, left, top, fill, anchor = "start", font = "12px") => out.push(`<text x="${left.toFixed(1)}" y="${top.toFixed(1)}" fill="${fill}" text-anchor="${anchor === "center" ? "middle" : anchor}" style="font:${font} system-ui, sans-serif">${escaped(said)}</text>`),
    image: (picture, left, top, width, height) => out.push(`<image href="${picture.toDataURL()}" x="${left}" y="${top}" width="${width}" height="${height}" preserveAspectRatio="none"/>`),
  });

  const svg = (entry) => {
    const { chart, figure } = entry;
    const scale = window.devicePixelRatio || 1;
    const [left, top, width, height] = ["left", "top", "width", "height"].map((side) => chart.bbox[side] / scale);
    const [soft, grid] = [colour("--soft"), colour("--grid")];
    const { min, max } = chart.scales.x;
    const out = [];
    const pen = scribe(out, (value) => left + chart.valToPos(value, "x"), (value) => top + chart.valToPos(value, "y"));
    // Points of a line in its unbroken runs.
    const runs = (values, gaps) => chart.data[0].reduce((found, at, row) => {
      if (at < min || at > max) return found;
      if (values[row] != null) found.at(-1).push([pen.x(at), pen.y(values[row])]);
      else if (!gaps) found.push([]);
      return found;
    }, [[]]);
    for (const [number, axis] of chart.axes.entries()) {
      for (const [index, split] of (axis._splits || []).entries()) {
        const text = String(axis._values[index] ?? "").split("\n")[0];
        if (!text) continue;
        const at = number ? pen.y(split) : pen.x(split);
        pen.line(number ? [[left, at], [left + width, at]] : [[at, top], [at, top + height]], grid);
        if (number) pen.text(text, left - 6, at + 4, soft, "end");
        else pen.text(text, at, top + height + 16, soft, "center");
      }
    }
    pen.text(figure.x.label, left + width / 2, top + height + 36, soft, "center");
    out.push(`<g transform="translate(14 ${top + height / 2}) rotate(-90)">`);
    pen.text(figure.y.label, 0, 0, soft, "center");
    // What lies within cuts off what lies beyond its sides.
    out.push(`</g><svg x="${left}" y="${top}" width="${width}" height="${height}" viewBox="${left} ${top} ${width} ${height}">`);
    for (const { series, fill } of figure.bands || []) {
      const [upper, lower] = series.map((number) => runs(chart.data[number], true)[0]);
      out.push(`<polygon points="${[...upper, ...lower.reverse()].join(" ")}" fill="${fill}"/>`);
    }
    for (const { stroke, line } of named(entry)) {
      const { dash, width: thick = 1.5, points, spanGaps, paths } = line.style || {};
      for (const run of runs(line.values, spanGaps)) {
        if (!paths && run.length > 1) pen.line(run, stroke, thick, dash);
        if (points?.show) for (const [x, y] of run) out.push(`<circle cx="${x}" cy="${y}" r="${points.size / 2}" fill="${points.fill ? "none" : stroke}" stroke="${stroke}"/>`);
      }
    }
    figure.paint?.(pen, chart, figure);
    out.push("</svg>");
    pen.text(figure.title || "", left, -24, colour("--text"));
    let at = left;
    for (const { name, stroke } of named(entry)) {
      pen.text(name, at, -6, stroke);
      at += 9 * (name.length + 2);
    }
    const [wide, tall] = [chart.width, chart.height + HEAD];
    const about = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;
    return new Blob([`<svg xmlns="${about}" viewBox="0 -${HEAD} ${wide} ${tall}" width="${wide}" height="${tall}"><rect y="-${HEAD}" width="${wide}" height="${tall}" fill="${colour("--card")}"/>`, ...out, "</svg>"], { type: "image/svg+xml" });
  };

  window.jointplay.saveChart = async (entry, kind) => {
    const href = URL.createObjectURL(await { csv, png, svg }[kind](entry));
    const name = entry.figure.file || (entry.figure.title || "chart").trim().toLowerCase().replace(/[^a-z0-9]+/g, "-");
    make("a", { href, download: `${name}.${kind}` }).click();
    setTimeout(() => URL.revokeObjectURL(href), 10000);
  };
})();
