"use strict";
// Charts of the page: lines over a common axis, and bars in groups. No library, no network.
const PALETTE = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c7a00"];
const SVG = "http://www.w3.org/2000/svg";
const SIZE = { width: 520, height: 260, left: 52, right: 12, top: 10, bottom: 38 };

function svg(name, attributes = {}, parent = null) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (parent) parent.appendChild(node);
  return node;
}

function html(name, parent, text = "", className = "") {
  const node = document.createElement(name);
  node.textContent = text;
  if (className) node.className = className;
  parent.appendChild(node);
  return node;
}

function read(element) {
  return JSON.parse(element.querySelector("script").textContent);
}

// about `count` round numbers in [low, high], no closer than `least`
function ticks(low, high, count = 5, least = 0) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= Math.max(rough, least)) ?? least;
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return found;
}

function told(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e5 || size < 1e-3 ? value.toExponential(1) : String(Number(value.toPrecision(4)));
}

function scale(low, high, from, to) {
  const span = high - low || 1;
  return (value) => from + ((value - low) / span) * (to - from);
}

function range(values) {
  const known = values.filter((value) => value !== null);
  const low = Math.min(...known), high = Math.max(...known);
  if (low !== high) return [low, high];
  const reach = Math.abs(low) || 1;
  return [low - 0.5 * reach, high + 0.5 * reach];
}

// frame, grid and titles; returns both scales. Numbers of epochs and cases are told as whole ones
function axes(picture, size, xs, ys, xTitle, yTitle, whole = false) {
  const x = scale(...xs, size.left, size.width - size.right);
  const y = scale(...ys, size.height - size.bottom, size.top);
  for (const value of ticks(...ys)) {
    svg("line", { x1: size.left, x2: size.width - size.right, y1: y(value), y2: y(value), stroke: "#e6e9ec" }, picture);
    svg("text", { x: size.left - 5, y: y(value) + 4, "text-anchor": "end" }, picture).textContent = told(value);
  }
  for (const value of xTitle === null ? [] : ticks(...xs, 6, whole ? 1 : 0)) {
    svg("text", { x: x(value), y: size.height - size.bottom + 14, "text-anchor": "middle" }, picture).textContent = told(value);
  }
  const middle = (size.left + size.width - size.right) / 2;
  svg("text", { x: middle, y: size.height - 6, "text-anchor": "middle" }, picture).textContent = xTitle ?? "";
  const title = svg("text", { transform: `translate(11 ${(size.top + size.height - size.bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, picture);
  title.textContent = yTitle;
  return { x, y };
}

function legend(figure, names, toggle) {
  const box = html("div", figure, "", "legend");
  names.forEach((name, index) => {
    const entry = html("span", box);
    const swatch = html("i", entry, "", index >= PALETTE.length ? "dashed" : "");
    swatch.style.color = PALETTE[index % PALETTE.length];
    entry.appendChild(document.createTextNode(name));
    entry.addEventListener("click", () => toggle(index, entry.classList.toggle("off")));
  });
}

function points(line, place) {
  const parts = [[]];
  line.x.forEach((value, index) => {
    if (line.y[index] === null) parts.push([]);
    else parts[parts.length - 1].push(`${place.x(value)},${place.y(line.y[index])}`);
  });
  return parts.filter((part) => part.length);
}

function drawLines(figure) {
  const content = read(figure);
  const picture = svg("svg", { width: SIZE.width, height: SIZE.height, viewBox: `0 0 ${SIZE.width} ${SIZE.height}` }, figure);
  const xs = range(content.lines.flatMap((line) => line.x));
  const ys = range(content.lines.flatMap((line) => line.y));
  const whole = content.lines.every((line) => line.x.every(Number.isInteger));
  const place = axes(picture, SIZE, xs, ys, content.x, content.y, whole);
  const groups = content.lines.map((line, index) => {
    const color = PALETTE[index % PALETTE.length];
    const group = svg("g", { stroke: color, fill: "none", "stroke-width": 1.7 }, picture);
    if (index >= PALETTE.length) group.setAttribute("stroke-dasharray", "5 3");
    for (const part of points(line, place)) {
      svg("polyline", { points: part.join(" ") }, group);
      if (content.marks) part.forEach((point) => {
        const [cx, cy] = point.split(",");
        svg("circle", { cx, cy, r: 2, fill: color }, group);
      });
    }
    return group;
  });
  legend(figure, content.lines.map((line) => line.name), (index, off) => {
    groups[index].style.display = off ? "none" : "";
  });
  const readout = html("div", figure, "", "readout");
  const cursor = svg("line", { y1: SIZE.top, y2: SIZE.height - SIZE.bottom, stroke: "#999", visibility: "hidden" }, picture);
  picture.addEventListener("mousemove", (event) => {
    const box = picture.getBoundingClientRect();
    const at = scale(0, box.width, 0, SIZE.width)(event.clientX - box.left);
    const nearest = content.lines.flatMap((line) => line.x).reduce((a, b) => (Math.abs(place.x(b) - at) < Math.abs(place.x(a) - at) ? b : a));
    cursor.setAttribute("x1", place.x(nearest));
    cursor.setAttribute("x2", place.x(nearest));
    cursor.setAttribute("visibility", "visible");
    const values = content.lines.map((line) => [line.name, line.y[line.x.indexOf(nearest)]]);
    const known = values.filter(([, value]) => value !== null && value !== undefined);
    readout.textContent = `${content.x} ${told(nearest)}: ` + known.map(([name, value]) => `${name} ${told(value)}`).join(", ");
  });
}

function drawBars(figure) {
  const content = read(figure);
  const names = Object.keys(content.values);
  const longest = Math.max(...content.groups.map((name) => name.length));
  const needed = Math.max(names.length * 10 + 14, longest * 6);
  const size = { ...SIZE, width: Math.max(SIZE.width, SIZE.left + SIZE.right + content.groups.length * needed) };
  const picture = svg("svg", { width: size.width, height: size.height, viewBox: `0 0 ${size.width} ${size.height}` }, figure);
  const [low, high] = range(Object.values(content.values).flat().concat(0));
  const place = axes(picture, size, [0, content.groups.length], [Math.min(low, 0), high], null, content.y);
  const width = (place.x(1) - place.x(0)) / (names.length + 1);
  content.groups.forEach((name, group) => {
    svg("text", { x: place.x(group + 0.5), y: size.height - size.bottom + 14, "text-anchor": "middle" }, picture).textContent = name;
  });
  const layers = names.map((name, index) => {
    const layer = svg("g", { fill: PALETTE[index % PALETTE.length] }, picture);
    content.values[name].forEach((value, group) => {
      if (value === null) return;
      const top = Math.min(place.y(value), place.y(0)), height = Math.abs(place.y(value) - place.y(0));
      const bar = svg("rect", { x: place.x(group) + (index + 0.5) * width, y: top, width: 0.9 * width, height }, layer);
      svg("title", {}, bar).textContent = `${name}, ${content.groups[group]}: ${told(value)}`;
    });
    return layer;
  });
  legend(figure, names, (index, off) => { layers[index].style.display = off ? "none" : ""; });
}

document.querySelectorAll(".chart.lines").forEach(drawLines);
document.querySelectorAll(".chart.bars").forEach(drawBars);
