"use strict";
// Series that can be zoomed and read off. Every figure of the page shows the same window of time.
(() => {
  const DAY = 864e5, STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, ...[1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800,
    3600, 7200, 10800, 21600, 43200].map((s) => 1e3 * s), ...[1, 2, 5, 10, 20, 50, 100, 365].map((d) => d * DAY)];
  const LEFT = 62, RIGHT = 20, TOP = 28, GAP = 34, FOOT = 40, INK = "#1b1f24", PALE = "#d9d9d9";
  const PAUSE = 8; // usual steps: a pause of that length breaks a line
  const figures = [...document.querySelectorAll("figure")].filter((f) => f.querySelector("script")).map(prepare);
  if (!figures.length) return;
  const whole = [Math.min(...figures.map((f) => f.t[0])), Math.max(...figures.map((f) => f.t[f.t.length - 1]))];
  let shown = whole, cursor = null, grabbed = null, waiting = false;

  function prepare(element) {
    const data = JSON.parse(element.querySelector("script").textContent);
    let stamp = 0;
    const t = data.steps_ms.map((step) => (stamp += step));
    for (const panel of data.panels) for (const line of panel.lines) {
      const missing = new Set(line.missing);
      line.t = line.rows ? line.rows.map((row) => t[row]) : t.filter((_, row) => !missing.has(row));
      const steps = line.t.slice(1).map((ms, k) => ms - line.t[k]).sort((a, b) => a - b);
      line.pause = Math.max(PAUSE * (steps[steps.length >> 1] || 1), data.pause_ms);
    }
    const canvas = make("canvas", element), readout = make("div", element, "readout"), tools = make("div", element, "tools");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", element.querySelector("img").alt);
    const words = make("code", tools), from = make("span", words, "whole");
    words.append(" ");
    const to = make("span", words, "whole");
    const button = (name, act) => { const b = make("button", tools); b.type = "button"; b.textContent = name; b.onclick = act; };
    button("copy", () => copy(words));
    button("whole record", () => zoom(whole));
    element.insertBefore(canvas, element.firstChild);
    canvas.after(readout, tools);
    element.classList.add("live");
    const one = { element, canvas, readout, from, to, t, rows: data.rows, knots: data.knots, panels: data.panels };
    canvas.addEventListener("pointerdown", (e) => { grabbed = at(one, e); canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener("pointermove", (e) => { cursor = at(one, e); later(); });
    canvas.addEventListener("pointerleave", () => { cursor = null; later(); });
    canvas.addEventListener("pointercancel", () => { grabbed = null; later(); });
    canvas.addEventListener("pointerup", (e) => {
      const from = grabbed, to = at(one, e);
      grabbed = null;
      if (from !== null && Math.abs(to - from) > 0.01 * (shown[1] - shown[0])) zoom([Math.min(from, to), Math.max(from, to)]);
    });
    canvas.addEventListener("dblclick", () => zoom(whole));
    return one;
  }

  function make(tag, parent, name) {
    const made = document.createElement(tag);
    if (name) made.className = name;
    return parent.appendChild(made);
  }

  function between(knots, from, to, value) { // knots: stamp and place on the axis, where pauses may be shortened
    let k = 1;
    while (k < knots.length - 1 && knots[k][from] < value) k++;
    const [a, b] = [knots[k - 1], knots[k]];
    return a[to] + ((value - a[from]) * (b[to] - a[to])) / (b[from] - a[from] || 1);
  }

  function at(one, event) { // the time under the pointer
    const box = one.canvas.getBoundingClientRect(), share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    const [a, b] = shown.map((ms) => between(one.knots, 0, 1, ms));
    return between(one.knots, 1, 0, a + Math.min(Math.max(share, 0), 1) * (b - a));
  }

  function zoom(window) { shown = window; later(); }

  function later() {
    if (!waiting) requestAnimationFrame(() => { waiting = false; figures.forEach(draw); });
    waiting = true;
  }

  function copy(words) {
    getSelection().selectAllChildren(words);
    if (navigator.clipboard) navigator.clipboard.writeText(words.textContent).catch(() => document.execCommand("copy"));
    else document.execCommand("copy");
  }

  function iso(ms) { return new Date(ms).toISOString(); }

  function number(value) { return Math.abs(value) < 1e3 ? String(Number(value.toPrecision(4))) : value.toFixed(1); }

  function first(t, ms) { // index of the first stamp that is not before ms
    let low = 0, high = t.length;
    while (low < high) { const middle = (low + high) >> 1; if (t[middle] < ms) low = middle + 1; else high = middle; }
    return low;
  }

  function ticks(low, high, most) {
    const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough), out = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) out.push(k * step);
    return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  }

  function extent(panel) {
    let low = Infinity, high = -Infinity;
    for (const line of panel.lines) if (line.look !== "cross")
      for (let k = first(line.t, shown[0]); k < line.t.length && line.t[k] <= shown[1]; k++) {
        low = Math.min(low, line.values[k]); high = Math.max(high, line.values[k]);
      }
    if (low > high) return [-1, 1];
    const room = 0.06 * (high - low) || 1e-6 * Math.abs(high) || 1;
    return [low - room, high + room];
  }

  function draw(one) {
    const width = one.element.clientWidth - 2, tall = width < 500 ? 96 : 122, ratio = devicePixelRatio || 1;
    const height = TOP + one.panels.length * (tall + GAP) - GAP + FOOT;
    one.canvas.width = width * ratio;
    one.canvas.height = height * ratio;
    const c = one.canvas.getContext("2d"), span = shown[1] - shown[0] || 1, across = width - LEFT - RIGHT;
    const [start, end] = shown.map((ms) => between(one.knots, 0, 1, ms));
    const x = (ms) => LEFT + (across * (between(one.knots, 0, 1, ms) - start)) / (end - start || 1);
    c.scale(ratio, ratio);
    c.fillStyle = "#fff";
    c.fillRect(0, 0, width, height);
    c.font = "12px system-ui, sans-serif";
    const step = STEPS.find((s) => s >= (end - start) / Math.max(2, across / 90)) || STEPS[STEPS.length - 1];
    one.panels.forEach((panel, index) => {
      const top = TOP + index * (tall + GAP), [low, high] = extent(panel), y = (v) => top + (tall * (high - v)) / (high - low);
      c.textBaseline = "middle";
      c.lineWidth = 1;
      const [marks, digits] = ticks(low, high, 5);
      const rule = (x0, y0, x1, y1) => { c.strokeStyle = PALE; c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke(); };
      c.fillStyle = INK;
      c.textAlign = "right";
      for (const v of marks) { rule(LEFT, y(v), width - RIGHT, y(v)); c.fillText(v.toFixed(digits), LEFT - 6, y(v)); }
      c.textAlign = "center";
      let day = "", last = -1e9, dated = -1e9;
      for (let ms = Math.ceil(shown[0] / step) * step; ms <= shown[1]; ms += step) {
        if (x(ms) < last + 45) continue;
        last = x(ms);
        rule(x(ms), top, x(ms), top + tall);
        if (index < one.panels.length - 1) continue;
        const text = iso(ms), date = text.slice(0, 10), clock = text.slice(11, step < 1e3 ? 23 : step < 6e4 ? 19 : 16);
        if (step < DAY) c.fillText(clock, x(ms), top + tall + 14);
        if (date === day || last < dated + 105) continue;
        c.fillText(`${date} UTC`, Math.min(Math.max(last, 54), width - 54), top + tall + 29);
        [day, dated] = [date, last];
      }
      legend(c, panel, top - 15);
      c.save();
      c.beginPath();
      c.rect(LEFT, top - 4, across, tall + 8);
      c.clip();
      for (const line of panel.lines) trace(c, line, x, y, [low, high], [top, top + tall]);
      c.restore();
      c.strokeStyle = INK;
      if (cursor !== null) { c.setLineDash([3, 3]); c.beginPath(); c.moveTo(x(cursor), top); c.lineTo(x(cursor), top + tall); c.stroke(); c.setLineDash([]); }
      if (grabbed !== null && cursor !== null) { c.fillStyle = "rgba(0,114,178,.15)"; c.fillRect(x(grabbed), top, x(cursor) - x(grabbed), tall); }
    });
    const unit = span < 6e4 ? 1 : 1e3; // --to is the first instant beyond the window, so that its last row is in it
    const brief = (ms) => iso(unit * Math.floor(ms / unit)).replace(".000", "");
    one.from.textContent = `--from ${brief(shown[0])}`;
    one.to.textContent = `--to ${brief(shown[1] + unit)}`;
    read(one);
  }

  function legend(c, panel, y) {
    c.textAlign = "left";
    c.fillStyle = INK;
    c.fillText(panel.label, 4, y);
    let place = 16 + c.measureText(panel.label).width;
    const named = panel.lines.filter((line) => line.name);
    const spare = c.canvas.clientWidth - named.reduce((sum, line) => sum + 28 + c.measureText(line.name).width, place - 14);
    const apart = 28 + Math.min(0, spare / Math.max(named.length - 1, 1));
    place = Math.max(place, Math.min(LEFT + 24, place + spare));
    for (const line of named) {
      mark(c, line, place, y, true);
      c.fillStyle = INK;
      c.fillText(line.name, place + 10, y);
      place += apart + c.measureText(line.name).width;
    }
  }

  function mark(c, line, x, y, large) {
    c.strokeStyle = c.fillStyle = line.colour;
    c.lineWidth = 1.5;
    const r = large ? 2.5 : 1.4;
    if (line.look === "dots") c.fillRect(x - r, y - r, 2 * r, 2 * r);
    else {
      c.beginPath();
      if (line.look === "line") { c.moveTo(x - 7, y); c.lineTo(x + 7, y); }
      else { c.moveTo(x - 3, y - 3); c.lineTo(x + 3, y + 3); c.moveTo(x - 3, y + 3); c.lineTo(x + 3, y - 3); }
      c.stroke();
    }
  }

  function trace(c, line, x, y, [low, high], [top, bottom]) {
    const from = Math.max(first(line.t, shown[0]) - 1, 0), to = Math.min(first(line.t, shown[1]) + 1, line.t.length);
    c.strokeStyle = line.colour;
    c.lineWidth = 1.5;
    c.globalAlpha = line.look === "dots" ? 0.7 : 1;
    if (line.look === "line") c.beginPath();
    for (let k = from; k < to; k++) {
      const v = line.values[k], px = x(line.t[k]);
      if (line.look === "line") {
        if (k === from || line.t[k] - line.t[k - 1] > line.pause) c.moveTo(px, y(v)); else c.lineTo(px, y(v));
      } else if (v > high || v < low) { // beyond the axes: an arrow at the edge
        const edge = v > high ? top : bottom, inward = v > high ? 7 : -7;
        c.fillStyle = line.colour;
        c.beginPath(); c.moveTo(px, edge); c.lineTo(px - 4, edge + inward); c.lineTo(px + 4, edge + inward); c.fill();
      } else mark(c, line, px, y(v), false);
    }
    if (line.look === "line") c.stroke();
    c.globalAlpha = 1;
  }

  function read(one) { // what lies under the cursor, as text
    if (cursor === null) {
      const some = one.rows > one.t.length ? ` Drawn: ${one.t.length} of ${one.rows} rows, the lowest and the highest among them.` : "";
      one.readout.textContent = `Drag to zoom, double click for the whole record; all figures of the page follow.${some}`;
      return;
    }
    const after = first(one.t, cursor), before = Math.max(after - 1, 0);
    const row = after === one.t.length || cursor - one.t[before] < one.t[after] - cursor ? before : after, ms = one.t[row];
    const said = one.panels.map((panel) => {
      const [, name, unit] = /^(.*?)(?: \[(.*)\])?$/.exec(panel.label);
      const parts = panel.lines.flatMap((line) => {
        const k = first(line.t, ms);
        return line.t[k] === ms ? [`${line.name || "set aside"} ${number(line.values[k])}`] : [];
      });
      return parts.length ? `${name}: ${parts.join(", ")}${unit ? ` ${unit}` : ""}` : "";
    });
    one.readout.textContent = [`${iso(ms)} (UTC)`, ...said.filter(Boolean)].join("; ");
  }

  addEventListener("resize", later);
  figures.forEach(draw);
})();
