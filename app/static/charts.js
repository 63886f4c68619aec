// Spectra by order: a few lines, and the range in which the first of them may lie.
"use strict";

(() => {
  const drawn = new Map();

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  const looks = (name) => ({
    matched: { stroke: colour("--matched"), width: 2, dash: [6, 4], points: { show: false } },
    rival: { stroke: colour("--rival"), width: 1.5, dash: [2, 3], points: { show: false } },
    measured: { stroke: colour("--measured"), width: 2, points: { show: true, size: 5 } },
    decided: { stroke: colour("--decided"), paths: () => null, points: { show: true, size: 12, width: 2.5, fill: "transparent" } },
  })[name];

  const options = (data, width) => {
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--grid"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 } };
    const level = (self, value) => (value == null ? "–" : `${value.toFixed(1)} dB`);
    return {
      width,
      height: Math.max(220, Math.min(320, width * 0.45)),
      scales: { x: { time: false, distr: 3, log: 10, range: [data.orders[0], data.orders[data.orders.length - 1]] } },
      axes: [
        { ...axis, label: "order of the drive", values: (self, ticks) => ticks.map((tick) => (tick == null ? "" : String(tick))) },
        { ...axis, label: data.label, size: 55 },
      ],
      series: [
        { label: "order", value: (self, value) => (value == null ? "–" : value.toPrecision(3)) },
        { label: "scatter, upper", stroke: "transparent", points: { show: false }, value: level },
        { label: "scatter, lower", stroke: "transparent", points: { show: false }, value: level },
        ...data.lines.map((line) => ({ label: line.name, value: level, ...looks(line.look) })),
      ],
      bands: [{ series: [1, 2], fill: colour("--scatter") }],
      legend: { show: width > 480 },
    };
  };

  const draw = (place) => {
    const data = JSON.parse(place.dataset.chart);
    drawn.get(place)?.destroy();
    place.replaceChildren();
    const table = [data.orders, data.upper, data.lower, ...data.lines.map((line) => line.levels)];
    drawn.set(place, new uPlot(options(data, place.clientWidth), table, place));
  };

  const drawAll = () => {
    for (const [place, chart] of drawn) {
      if (!place.isConnected) {
        chart.destroy();
        drawn.delete(place);
      }
    }
    for (const place of document.querySelectorAll("[data-chart]")) draw(place);
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
