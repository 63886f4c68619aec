// Charts as files: CSV of the numbers, PNG of the canvas, SVG drawn anew from the same lines.
"use strict";

(() => {
  const SVG = new DOMParser().parseFromString("<svg></svg>", "text/html").querySelector("svg").namespaceURI;
  const escaped = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);

  const written = (rows, cell) => new Blob([rows.map((row) => row.map(cell).join(",")).join("\r\n"), "\r\n"], { type: "text/csv" });
  const csv = ({ figure }) => {
    const cell = (value) => (typeof value === "string" && /[",\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value ?? "");
    const head = [figure.x.label, ...figure.lines.map((line) => (line.unit ? `${line.name} [${line.unit}]` : `${line.name} [${figure.y.label}]`))];
    if (figure.csv) return written([figure.csv.head, ...figure.csv.rows], cell);
    const rows = figure.at.map((at, row) => [at, ...figure.lines.map((line) => line.values[row])]);
    return written([head, ...rows], cell);
  };

  const named = ({ chart, figure }) => chart.series.slice(1)
    .map((series, index) => ({ name: series.label, stroke: series._stroke || series.stroke(chart), line: figure.lines[index], show: series.show }))
    .filter((each) => each.show && !each.line.silent && each.stroke !== "transparent");

  const png = ({ chart, figure }) => new Promise((resolve) => {
    const { colour } = window.jointplay;
    const source = chart.ctx.canvas;
    const scale = window.devicePixelRatio || 1;
    const canvas = document.createElement("canvas");
    canvas.width = source.width;
    canvas.height = source.height + 40 * scale;
    const pen = canvas.getContext("2d");
    pen.fillStyle = colour("--card");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(source, 0, 40 * scale);
    pen.font = `${13 * scale}px system-ui, sans-serif`;
    pen.fillStyle = colour("--text");
    pen.fillText(figure.title || "", 8 * scale, 16 * scale);
    let left = 8 * scale;
    for (const { name, stroke } of named({ chart, figure })) {
      pen.fillStyle = stroke;
      pen.fillText(`— ${name}`, left, 34 * scale);
      left += pen.measureText(`— ${name}   `).width;
    }
    canvas.toBlob(resolve, "image/png");
  });

  // The part of a canvas's pen that figures paint with, written down as SVG.
  const scribe = (out) => {
    let path = "";
    return {
      save() {}, restore() {},
      beginPath() { path = ""; },
      moveTo(x, y) { path += `M${x.toFixed(2)} ${y.toFixed(2)}`; },
      lineTo(x, y) { path += `L${x.toFixed(2)} ${y.toFixed(2)}`; },
      setLineDash(dash) { this.dash = dash; },
      stroke() { out.push(`<path d="${path}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-dasharray="${(this.dash || []).join(" ")}"/>`); },
      fillText(text, x, y) { out.push(`<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" fill="${this.fillStyle}" text-anchor="${this.textAlign === "center" ? "middle" : "start"}">${escaped(text)}</text>`); },
      drawImage(image, x, y, width, height) { out.push(`<image href="${image.toDataURL()}" x="${x}" y="${y}" width="${width}" height="${height}" preserveAspectRatio="none"/>`); },
    };
  };

  const svg = (entry) => {
    const { chart, figure } = entry;
    const { colour } = window.jointplay;
    const scale = window.devicePixelRatio || 1;
    const [left, top, width, height] = ["left", "top", "width", "height"].map((side) => chart.bbox[side] / scale);
    const x = (value) => left + chart.valToPos(value, "x");
    const y = (value) => top + chart.valToPos(value, "y");
    const dots = (line) => chart.data[0].map((at, row) => [at, line[row]]).filter(([at]) => at >= chart.scales.x.min && at <= chart.scales.x.max);
    const trace = (line, gaps) => {
      let pen = "M";
      return dots(line).map(([at, value]) => {
        if (value == null) {
          if (!gaps) pen = "M";
          return "";
        }
        const step = `${pen}${x(at).toFixed(2)} ${y(value).toFixed(2)}`;
        pen = "L";
        return step;
      }).join("");
    };
    const out = [];
    for (const [number, axis] of chart.axes.entries()) {
      for (const [index, split] of (axis._splits || []).entries()) {
        const text = axis._values[index];
        if (text == null || text === "") continue;
        const at = number ? y(split) : x(split);
        const ends = number ? `x1="${left}" x2="${left + width}" y1="${at}" y2="${at}"` : `x1="${at}" x2="${at}" y1="${top}" y2="${top + height}"`;
        out.push(`<line ${ends} stroke="${colour("--grid")}"/>`);
        const place = number ? `x="${left - 6}" y="${at + 4}" text-anchor="end"` : `x="${at}" y="${top + height + 16}" text-anchor="middle"`;
        out.push(`<text ${place} fill="${colour("--soft")}">${escaped(String(text).split("\n")[0])}</text>`);
      }
    }
    out.push(`<text x="${left + width / 2}" y="${top + height + 36}" text-anchor="middle" fill="${colour("--soft")}">${escaped(figure.x.label)}</text>`);
    out.push(`<text transform="translate(14 ${top + height / 2}) rotate(-90)" text-anchor="middle" fill="${colour("--soft")}">${escaped(figure.y.label)}</text>`);
    // What lies within cuts off what lies beyond its sides.
    out.push(`<svg x="${left}" y="${top}" width="${width}" height="${height}" viewBox="${left} ${top} ${width} ${height}">`);
    for (const band of figure.bands || []) {
      const [upper, lower] = band.series.map((number) => dots(chart.data[number]).filter(([, value]) => value != null));
      const corner = ([at, value]) => `${x(at).toFixed(2)},${y(value).toFixed(2)}`;
      out.push(`<polygon points="${[...upper, ...lower.reverse()].map(corner).join(" ")}" fill="${band.fill}"/>`);
    }
    for (const { stroke, line } of named(entry)) {
      const { dash = [], width: thick = 1.5, points, spanGaps, paths } = line.style || {};
      if (!paths) out.push(`<path d="${trace(line.values, spanGaps)}" fill="none" stroke="${stroke}" stroke-width="${thick}" stroke-dasharray="${dash.join(" ")}"/>`);
      if (points?.show) for (const [at, value] of dots(line.values)) if (value != null) out.push(`<circle cx="${x(at).toFixed(2)}" cy="${y(value).toFixed(2)}" r="${points.size / 2}" fill="${points.fill ? "none" : stroke}" stroke="${stroke}"/>`);
    }
    figure.paint?.({ pen: scribe(out), scale: 1, x, y }, chart, figure);
    out.push("</svg>");
    let at = left;
    const names = named(entry).map(({ name, stroke }) => {
      const text = `<text x="${at}" y="-6" fill="${stroke}">— ${escaped(name)}</text>`;
      at += 9 * (name.length + 4);
      return text;
    });
    const [wide, tall] = [chart.width, chart.height + 40];
    return new Blob([`<svg xmlns="${SVG}" viewBox="0 -40 ${wide} ${tall}" width="${wide}" height="${tall}" font-family="system-ui, sans-serif" font-size="12">`,
      `<rect y="-40" width="${wide}" height="${tall}" fill="${colour("--card")}"/><text x="${left}" y="-24" fill="${colour("--text")}">${escaped(figure.title || "")}</text>`, ...names, ...out, "</svg>"], { type: "image/svg+xml" });
  };

  const MAKERS = { csv, png, svg };

  window.jointplay.saveChart = async (entry, kind) => {
    const blob = await MAKERS[kind](entry);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${entry.figure.file || (entry.figure.title || "chart").trim().toLowerCase().replace(/[^a-z0-9]+/g, "-")}.${kind}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  };
})();
