"use strict";
// Scenes that play: a slider over time, layers that can be hidden, and series under the picture.
const LAYERS = {
  candidate: "candidates", prediction: "prediction", ellipse: "forecast, 90 %", agent: "agents", human: "human", plan: "plan",
  robot: "robot and its way", intent: "plan of the moment",
};
const NINETY = 4.605; // 90 % of a planar Gaussian lie within this squared distance in deviations

class Player {
  constructor(box) {
    this.box = box;
    this.scenes = read(box);
    this.slider = box.querySelector("input[type=range]");
    this.output = box.querySelector("output");
    this.button = box.querySelector("button");
    this.hidden = new Set();
    this.timer = null;
    box.querySelector("select").addEventListener("change", (event) => this.choose(Number(event.target.value)));
    this.slider.addEventListener("input", () => this.show(Number(this.slider.value)));
    this.button.addEventListener("click", () => (this.timer ? this.pause() : this.play()));
    const used = this.roles();
    for (const [role, name] of Object.entries(LAYERS)) if (used.has(role)) this.layer(role, name);
    this.choose(0);
  }

  // what at least one of the scenes shows
  roles() {
    const frames = this.scenes.flatMap((scene) => scene.frames);
    const drawn = this.scenes.flatMap((scene) => [...scene.lines, ...scene.bodies]).concat(frames.flatMap((frame) => frame.lines));
    const ellipses = frames.some((frame) => frame.ellipses.length) ? ["ellipse"] : [];
    return new Set([...drawn.map((each) => each.role), ...ellipses]);
  }

  layer(role, name) {
    const label = html("label", this.box.querySelector(".layers"));
    const tick = html("input", label);
    tick.type = "checkbox";
    tick.checked = true;
    tick.addEventListener("change", () => {
      if (tick.checked) this.hidden.delete(role); else this.hidden.add(role);
      this.draw();
    });
    html("i", label, "", role === "ellipse" ? "prediction" : role);
    label.appendChild(document.createTextNode(name));
  }

  choose(number) {
    this.pause();
    this.scene = this.scenes[number];
    this.slider.max = this.scene.times.length - 1;
    this.slider.value = this.scene.start;
    this.draw();
  }

  play() {
    const { times } = this.scene;
    const step = times.length > 1 ? times[1] - times[0] : 0.1;
    this.button.textContent = "pause";
    this.timer = setInterval(() => {
      const next = (Number(this.slider.value) + 1) % times.length;
      this.slider.value = next;
      this.show(next);
    }, 1000 * step);
  }

  pause() {
    clearInterval(this.timer);
    this.timer = null;
    this.button.textContent = "play";
  }

  // what stays: the frame of the picture, goal, lines; then the present time
  draw() {
    const stage = this.box.querySelector(".stage");
    stage.replaceChildren();
    const goals = this.scene.goals ?? (this.scene.goal ? [this.scene.goal] : []);
    const places = this.scene.lines.flatMap((line) => line.points)
      .concat(goals)
      .concat(this.scene.bodies.filter((body) => body.role !== "agent").flatMap((body) => body.path).filter(Boolean));
    if (this.scene.series.length) places.push(...this.scene.bodies.flatMap((body) => body.path).filter(Boolean));
    const xs = range(places.map((place) => place[0])), ys = range(places.map((place) => place[1]));
    const margin = 1.5;
    const width = xs[1] - xs[0] + 2 * margin, height = ys[1] - ys[0] + 2 * margin;
    this.unit = Math.max(width / 1100, height / 520); // m per pixel, about
    // y grows upwards in the scene and downwards in the picture
    this.picture = svg("svg", { viewBox: `${xs[0] - margin} ${-ys[1] - margin} ${width} ${height}` }, stage);
    this.grid(xs, ys, margin);
    const still = svg("g", {}, this.picture);
    for (const line of this.scene.lines) this.line(still, line, line.role === "candidate" ? 0.8 : 1.6);
    for (const [x, y] of goals) {
      svg("circle", { cx: x, cy: -y, r: 5 * this.unit, "stroke-width": this.unit, class: "goal" }, still);
    }
    this.moving = svg("g", { class: "moving" }, this.picture);
    this.series();
    this.show(Number(this.slider.value));
  }

  grid(xs, ys, margin) {
    const step = Math.max(ticks(...xs)[1] - ticks(...xs)[0], ticks(...ys)[1] - ticks(...ys)[0]) || 1;
    const text = { "font-size": 10 * this.unit, style: `font-size:${10 * this.unit}px` };
    const far = 20 * step;
    const first = (low) => Math.ceil((low - margin - far) / step) * step;
    for (let x = first(xs[0]); x <= xs[1] + far; x += step) {
      svg("line", { x1: x, x2: x, y1: -ys[1] - far, y2: -ys[0] + far, stroke: "#eceff1", "stroke-width": this.unit }, this.picture);
      svg("text", { ...text, x, y: -ys[0] + margin - 4 * this.unit }, this.picture).textContent = `${told(x)} m`;
    }
    for (let y = first(ys[0]); y <= ys[1] + far; y += step) {
      svg("line", { x1: xs[0] - far, x2: xs[1] + far, y1: -y, y2: -y, stroke: "#eceff1", "stroke-width": this.unit }, this.picture);
      svg("text", { ...text, x: xs[0] - margin + 3 * this.unit, y: -y }, this.picture).textContent = `${told(y)} m`;
    }
  }

  line(parent, line, width) {
    if (this.hidden.has(line.role)) return;
    const given = line.points.filter((point) => point && point[0] !== null).map(([x, y]) => `${x},${-y}`).join(" ");
    const opacity = 0.35 + 0.55 * (line.weight ?? 1);
    svg("polyline", { points: given, class: line.role, "stroke-width": width * this.unit, opacity }, parent);
  }

  body(parent, body, step) {
    const place = body.path[step];
    if (!place || place[0] === null || this.hidden.has(body.role)) return;
    const [x, y, heading] = place;
    const common = { class: body.role, "fill-opacity": 0.45, "stroke-width": 1.2 * this.unit };
    let shape;
    if (body.shape.radius) {
      shape = svg("circle", { ...common, cx: x, cy: -y, r: body.shape.radius }, parent);
    } else {
      const { length, width } = body.shape;
      const turn = `translate(${x} ${-y}) rotate(${(-(heading ?? 0) * 180) / Math.PI})`;
      shape = svg("path", { ...common, transform: turn,
        d: `M${-length / 2} ${-width / 2}H${length / 3}L${length / 2} 0L${length / 3} ${width / 2}H${-length / 2}Z` }, parent);
    }
    svg("title", {}, shape).textContent = body.name;
  }

  // half axes and angle from the eigenvalues of the covariance
  ellipse(parent, [x, y, xx, xy, yy, weight]) {
    if (this.hidden.has("ellipse")) return;
    const mean = (xx + yy) / 2, spread = Math.hypot((xx - yy) / 2, xy);
    const angle = 0.5 * Math.atan2(2 * xy, xx - yy);
    svg("ellipse", {
      rx: Math.sqrt(NINETY * (mean + spread)), ry: Math.sqrt(NINETY * Math.max(mean - spread, 0)),
      transform: `translate(${x} ${-y}) rotate(${(-angle * 180) / Math.PI})`,
      class: "prediction", "fill-opacity": 0.05 + 0.2 * weight, "stroke-opacity": 0.15 + 0.6 * weight, "stroke-width": this.unit,
    }, parent);
  }

  show(step) {
    const { times, frames, bodies } = this.scene;
    this.output.textContent = `${times[step].toFixed(2)} s`;
    this.moving.replaceChildren();
    for (const each of frames[step].ellipses) this.ellipse(this.moving, each);
    for (const line of frames[step].lines) this.line(this.moving, line, line.role === "candidate" ? 0.8 : 2.2);
    for (const body of bodies) this.body(this.moving, body, step);
    for (const cursor of this.cursors) cursor.move(times[step]);
  }

  series() {
    const box = this.box.querySelector(".series");
    box.replaceChildren();
    const size = { width: 270, height: 130, left: 48, right: 8, top: 8, bottom: 32 };
    this.cursors = this.scene.series.map((each) => {
      const picture = svg("svg", { width: size.width, height: size.height }, box);
      const place = axes(picture, size, range(this.scene.times), range(each.values), "time [s]", each.name);
      for (const part of points({ x: this.scene.times, y: each.values }, place)) {
        svg("polyline", { points: part.join(" "), fill: "none", stroke: "#0072B2", "stroke-width": 1.6 }, picture);
      }
      const cursor = svg("line", { y1: size.top, y2: size.height - size.bottom, stroke: "#D55E00" }, picture);
      const move = (time) => { cursor.setAttribute("x1", place.x(time)); cursor.setAttribute("x2", place.x(time)); };
      return { move };
    });
  }
}

document.querySelectorAll(".scenes").forEach((box) => { box.player = new Player(box); });
