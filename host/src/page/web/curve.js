// The focus measure over time, and over height while a scan runs.

import { $, colour, pencil, short } from "./dom.js";

export class Curve {
  #scan = 0;
  #samples = [];
  #state = null;

  /** New samples of a scan. */
  add({ scan, from, samples }) {
    if (scan !== this.#scan) [this.#scan, this.#samples] = [scan, []];
    this.#samples.splice(from, this.#samples.length, ...samples);
    this.draw();
  }

  show(state) {
    this.#state = state;
    if (state.focus.scan !== this.#scan) [this.#scan, this.#samples] = [state.focus.scan, []];
    this.draw();
  }

  draw() {
    const { pen, width, height } = pencil($("curve"));
    pen.clearRect(0, 0, width, height);
    const [left, right, top, bottom] = [8, width - 8, 10, height - 24];
    pen.strokeStyle = colour("line");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(left, bottom + 0.5);
    pen.lineTo(right, bottom + 0.5);
    pen.stroke();
    pen.fillStyle = colour("faint");
    pen.font = "12px system-ui";
    const samples = this.#samples;
    $("curve").dataset.samples = samples.length;
    if (samples.length === 0) {
      pen.textAlign = "center";
      pen.fillText("the focus curve comes here", width / 2, height / 2);
      return;
    }
    const zs = samples.map(([z]) => z);
    const phis = samples.map(([, phi]) => phi);
    let [z0, z1, p0, p1] = [Math.min(...zs), Math.max(...zs), Math.min(...phis), Math.max(...phis)];
    if (z1 - z0 < 2) [z0, z1] = [(z0 + z1) / 2 - 1, (z0 + z1) / 2 + 1];
    if (!(p1 > p0)) [p0, p1] = [p0 - 1, p1 + 1];
    const x = (z) => left + ((z - z0) / (z1 - z0)) * (right - left);
    const y = (phi) => bottom - ((phi - p0) / (p1 - p0)) * (bottom - top);
    pen.textAlign = "left";
    pen.fillText(`${z0.toFixed(1)} µm`, left, height - 6);
    pen.textAlign = "right";
    pen.fillText(`${z1.toFixed(1)} µm`, right, height - 6);
    const focused = this.#state?.focus.scan === this.#scan ? this.#state.focus.focused_um : null;
    if (focused !== null && focused !== undefined) {
      pen.strokeStyle = colour("accent");
      pen.setLineDash([4, 4]);
      pen.beginPath();
      pen.moveTo(x(focused), top);
      pen.lineTo(x(focused), bottom);
      pen.stroke();
      pen.setLineDash([]);
      pen.fillStyle = colour("accent");
      const near = x(focused) > width - 130;
      pen.textAlign = near ? "right" : "left";
      pen.fillText(`focus ${focused.toFixed(2)} µm`, x(focused) + (near ? -6 : 6), top + 8);
    }
    pen.strokeStyle = colour("accent");
    pen.globalAlpha = 0.35;
    pen.lineWidth = 1.5;
    pen.beginPath();
    [...samples].sort((a, b) => a[0] - b[0]).forEach(([z, phi], i) => (i ? pen.lineTo(x(z), y(phi)) : pen.moveTo(x(z), y(phi))));
    pen.stroke();
    pen.globalAlpha = 1;
    pen.fillStyle = colour("accent");
    for (const [z, phi] of samples) dot(pen, x(z), y(phi), 2);
    const [z, phi] = samples[samples.length - 1];
    if (this.#state?.activity.doing === "autofocus") {
      pen.fillStyle = colour("warm");
      dot(pen, x(z), y(phi), 4.5);
    }
  }
}

function dot(pen, x, y, r) {
  pen.beginPath();
  pen.arc(x, y, r, 0, 7);
  pen.fill();
}

/** The measure of the last seconds. */
export class Trace {
  #values = [];

  add(value, fault) {
    const place = $("focus-value");
    place.classList.toggle("fault", fault !== null);
    const text = fault ?? (value === null ? "" : `Φ ${short(value)}`);
    if (place.textContent !== text) place.textContent = text;
    this.#values.push(value);
    if (this.#values.length > 240) this.#values.shift();
    const { pen, width, height } = pencil($("trace"));
    pen.clearRect(0, 0, width, height);
    const known = this.#values.filter((v) => v !== null);
    if (known.length < 2) return;
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const y = (v) => height - 3 - ((v - low) / (high - low || 1)) * (height - 6);
    pen.strokeStyle = colour("accent");
    pen.lineWidth = 1.5;
    pen.beginPath();
    let drawing = false;
    this.#values.forEach((v, i) => {
      const x = ((240 - this.#values.length + i) / 239) * width;
      if (v !== null) drawing ? pen.lineTo(x, y(v)) : pen.moveTo(x, y(v));
      drawing = v !== null;
    });
    pen.stroke();
  }
}
