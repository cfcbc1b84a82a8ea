// The live picture: zoom, contrast, crosshair, region, tips, and what a click means.

import { $, colour, element, pencil, say } from "./dom.js";

const TOOLS = { look: "Look", region: "Region" };

export class Picture {
  #connection;
  #act;
  #image = null;
  #header = null;
  #zoom = 1;
  #fitted = true;
  #centre = [0, 0];
  #tool = "look";
  #drag = null;
  #marks = [];
  #due = false;
  #tools = new Map();

  /** `act(what, at)` is called for clicks that mean something. */
  constructor(connection, act) {
    this.#connection = connection;
    this.#act = act;
    connection.addEventListener("picture", ({ detail }) => this.#take(detail));
    connection.addEventListener("open", () => this.#levels());
    const canvas = $("view");
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", () => (this.#drag = null));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), [event.offsetX, event.offsetY]);
    }, { passive: false });
    new ResizeObserver(() => this.draw()).observe(canvas);
    $("zoom-in").onclick = () => this.zoom(1.25);
    $("zoom-out").onclick = () => this.zoom(0.8);
    $("fit").onclick = () => this.fit();
    $("cross").onclick = () => this.cross();
    $("auto").onclick = () => {
      this.#press("auto", !this.#pressed("auto"));
      this.#levels();
    };
    for (const id of ["black", "white"]) {
      $(id).oninput = () => {
        this.#press("auto", false);
        this.#levels();
      };
    }
    this.offer(TOOLS);
  }

  /** The tools there are: what a click may do. */
  offer(tools) {
    const names = Object.keys(tools);
    if (names.join() === [...this.#tools.keys()].join()) return;
    this.#tools = new Map(Object.entries(tools));
    if (!this.#tools.has(this.#tool)) this.#tool = "look";
    $("tools").replaceChildren(...names.map((name) => element("button", {
      type: "button", role: "radio", id: `tool-${name}`, "aria-checked": String(name === this.#tool),
      onclick: () => this.choose(name),
    }, tools[name])));
  }

  choose(tool) {
    if (!this.#tools.has(tool)) return;
    this.#tool = tool;
    for (const button of $("tools").children) button.setAttribute("aria-checked", String(button.id === `tool-${tool}`));
    $("view").style.cursor = tool === "look" ? "grab" : "crosshair";
    this.draw();
  }

  get tool() {
    return this.#tool;
  }

  /** Things drawn over the picture: { x, y, kind, text, to: [x, y] }. */
  mark(marks) {
    this.#marks = marks;
    this.#later();
  }

  cross() {
    this.#press("cross", !this.#pressed("cross"));
    this.draw();
  }

  #pressed = (id) => $(id).getAttribute("aria-pressed") === "true";
  #press = (id, on) => $(id).setAttribute("aria-pressed", String(on));

  #levels() {
    const full = this.#connection.state?.camera.bits === 8 ? 255 : 65535;
    const value = (id) => Math.round((Number($(id).value) / 1000) * full);
    const levels = this.#pressed("auto") ? "auto" : { fixed: { low: value("black"), high: Math.max(value("white"), value("black") + 1) } };
    this.#connection.send({ type: "levels", levels });
  }

  async #take({ header, jpeg }) {
    try {
      const image = await createImageBitmap(jpeg);
      this.#image?.close();
      const new_size = this.#header?.width !== header.width || this.#header?.height !== header.height;
      [this.#image, this.#header] = [image, header];
      if (new_size) this.fit();
      if (this.#pressed("auto")) {
        const full = this.#connection.state?.camera.bits === 8 ? 255 : 65535;
        $("black").value = (1000 * header.low) / full;
        $("white").value = (1000 * header.high) / full;
      }
      document.documentElement.dataset.frame = header.frame;
    } catch {
      // A damaged picture: the next one comes.
    }
    // Drawn with the screen's next picture; only then the next one is asked for. A hidden tab asks for none.
    requestAnimationFrame(() => {
      this.draw();
      this.#connection.send({ type: "drawn" });
    });
  }

  #later() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.draw();
    });
  }

  fit() {
    this.#fitted = true;
    this.draw();
  }

  zoom(factor, at) {
    const { width, height } = $("view").getBoundingClientRect();
    const [x, y] = at ?? [width / 2, height / 2];
    const fixed = this.#inPicture(x, y);
    this.#fitted = false;
    this.#zoom = Math.min(40, Math.max(0.05, this.#zoom * factor));
    this.#centre = [fixed[0] - (x - width / 2) / this.#zoom, fixed[1] - (y - height / 2) / this.#zoom];
    this.draw();
  }

  /** Frame pixel under a point of the canvas; (0, 0) is the centre of the top-left one. */
  #inPicture(x, y) {
    const { width, height } = $("view").getBoundingClientRect();
    return [this.#centre[0] + (x - width / 2) / this.#zoom, this.#centre[1] + (y - height / 2) / this.#zoom];
  }

  #down(event) {
    if (event.button !== 0 || !this.#header) return;
    $("view").setPointerCapture(event.pointerId);
    const from = [event.offsetX, event.offsetY];
    this.#drag = { from, centre: [...this.#centre], moved: false, to: from };
  }

  #move(event) {
    if (!this.#header) return;
    const [x, y] = this.#inPicture(event.offsetX, event.offsetY);
    say($("pointer"), `${x.toFixed(1)}, ${y.toFixed(1)} px${this.#um(x, y)}`);
    if (!this.#drag) return;
    const [dx, dy] = [event.offsetX - this.#drag.from[0], event.offsetY - this.#drag.from[1]];
    this.#drag.moved ||= Math.hypot(dx, dy) > 4;
    this.#drag.to = [event.offsetX, event.offsetY];
    if (this.#drag.moved && this.#tool === "look") {
      this.#fitted = false;
      this.#centre = [this.#drag.centre[0] - dx / this.#zoom, this.#drag.centre[1] - dy / this.#zoom];
    }
    this.#later();
  }

  #um(x, y) {
    const size = this.#connection.state?.calibrated.pixel_um;
    if (!size) return "";
    const [w, h] = [this.#header.width, this.#header.height];
    const far = Math.hypot((x - (w - 1) / 2) * size[0], (y - (h - 1) / 2) * size[1]);
    return `   ${far.toFixed(1)} µm from the centre`;
  }

  #up(event) {
    const drag = this.#drag;
    this.#drag = null;
    if (!drag) return;
    if (this.#tool === "region") {
      const region = drag.moved ? this.#region(drag) : null;
      this.#act("region", region);
      this.choose("look");
    } else if (!drag.moved && this.#tool !== "look") {
      const [x, y] = this.#inPicture(event.offsetX, event.offsetY);
      this.#act(this.#tool, { x_px: x, y_px: y });
    }
    this.draw();
  }

  #region({ from, to }) {
    const [a, b] = [this.#inPicture(...from), this.#inPicture(...to)];
    const edge = (v, size) => Math.min(size, Math.max(0, Math.round(v + 0.5)));
    const [left, right] = [edge(Math.min(a[0], b[0]), this.#header.width), edge(Math.max(a[0], b[0]), this.#header.width)];
    const [top, bottom] = [edge(Math.min(a[1], b[1]), this.#header.height), edge(Math.max(a[1], b[1]), this.#header.height)];
    return right - left > 3 && bottom - top > 3 ? { x: left, y: top, width: right - left, height: bottom - top } : null;
  }

  draw() {
    const { pen, width, height, scale } = pencil($("view"));
    pen.fillStyle = "#000";
    pen.fillRect(0, 0, width, height);
    if (!this.#header || width === 0) return;
    const { width: w, height: h } = this.#header;
    if (this.#fitted) {
      this.#zoom = Math.min(width / w, height / h);
      this.#centre = [(w - 1) / 2, (h - 1) / 2];
    }
    say($("zoom"), `${Math.round(100 * this.#zoom)} %`);
    const onScreen = (x, y) => [width / 2 + (x - this.#centre[0]) * this.#zoom, height / 2 + (y - this.#centre[1]) * this.#zoom];
    const [left, top] = onScreen(-0.5, -0.5);
    pen.imageSmoothingEnabled = this.#zoom * scale < 3;
    pen.drawImage(this.#image, left, top, w * this.#zoom, h * this.#zoom);
    if (this.#pressed("cross")) cross(pen, onScreen((w - 1) / 2, (h - 1) / 2), width, height);
    const region = this.#connection.state?.focus.region;
    if (region) {
      const [x, y] = onScreen(region.x - 0.5, region.y - 0.5);
      frame(pen, x, y, region.width * this.#zoom, region.height * this.#zoom, colour("accent"), "focus");
    }
    for (const mark of this.#marks) drawMark(pen, mark, onScreen);
    const drag = this.#drag;
    if (drag?.moved && this.#tool === "region") {
      const [[x0, y0], [x1, y1]] = [drag.from, drag.to];
      frame(pen, Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0), colour("warm"), "");
    }
    this.#bar(pen, width, height);
  }

  /** A scale bar, once a pixel's size is known. */
  #bar(pen, width, height) {
    const size = this.#connection.state?.calibrated.pixel_um?.[0];
    if (!size) return;
    const wanted = (120 / this.#zoom) * size;
    const step = 10 ** Math.floor(Math.log10(wanted));
    const um = [5, 2, 1].find((n) => n * step <= wanted) * step;
    const long = (um / size) * this.#zoom;
    pen.fillStyle = "#000a";
    pen.fillRect(width - long - 34, height - 44, long + 24, 34);
    pen.fillStyle = "#fff";
    pen.fillRect(width - long - 22, height - 20, long, 3);
    pen.font = "12px system-ui";
    pen.textAlign = "center";
    pen.fillText(`${um} µm`, width - 22 - long / 2, height - 26);
  }
}

function cross(pen, [x, y], width, height) {
  for (const [style, thick] of [["#0009", 3], [colour("warm"), 1]]) {
    pen.strokeStyle = style;
    pen.lineWidth = thick;
    pen.beginPath();
    for (const [x0, y0, x1, y1] of [[0, y, x - 14, y], [x + 14, y, width, y], [x, 0, x, y - 14], [x, y + 14, x, height]]) {
      pen.moveTo(x0, y0);
      pen.lineTo(x1, y1);
    }
    pen.globalAlpha = 0.55;
    pen.stroke();
    pen.globalAlpha = 1;
  }
}

function frame(pen, x, y, w, h, style, text) {
  pen.strokeStyle = "#000a";
  pen.lineWidth = 4;
  pen.strokeRect(x, y, w, h);
  pen.strokeStyle = style;
  pen.lineWidth = 1.5;
  pen.strokeRect(x, y, w, h);
  label(pen, text, x, y - 6, style);
}

function label(pen, text, x, y, style) {
  if (!text) return;
  pen.font = "600 12px system-ui";
  pen.textAlign = "left";
  pen.lineWidth = 3;
  pen.strokeStyle = "#000c";
  pen.strokeText(text, x, y);
  pen.fillStyle = style;
  pen.fillText(text, x, y);
}

function drawMark(pen, { x, y, kind, text, to }, onScreen) {
  const [px, py] = onScreen(x, y);
  const style = colour({ tip: "accent", expected: "accent", sample: "warm", outlier: "bad", undone: "faint" }[kind] ?? "text");
  for (const [ink, thick] of [["#000b", 4], [style, 1.6]]) {
    pen.strokeStyle = ink;
    pen.lineWidth = thick;
    pen.beginPath();
    if (kind === "expected") {
      pen.arc(px, py, 16, 0, 7);
    } else if (kind === "tip") {
      pen.arc(px, py, 9, 0, 7);
      pen.moveTo(px - 15, py);
      pen.lineTo(px - 4, py);
      pen.moveTo(px + 4, py);
      pen.lineTo(px + 15, py);
    } else {
      pen.moveTo(px - 6, py - 6);
      pen.lineTo(px + 6, py + 6);
      pen.moveTo(px - 6, py + 6);
      pen.lineTo(px + 6, py - 6);
    }
    if (to) {
      pen.moveTo(px, py);
      pen.lineTo(...onScreen(...to));
    }
    pen.stroke();
  }
  label(pen, text, px + 14, py - 10, style);
}
