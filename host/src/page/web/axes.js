// The axes: where they are, how far they may go, and what moves them.

import { $, element, say } from "./dom.js";

const EVERY_MS = 60;
const NAMES = { scope: "Microscope" };

export class Axes {
  #connection;
  #fail;
  #rows = new Map();
  #devices = [];
  #held = new Map();
  #timer = null;
  chosen = "scope";

  constructor(connection, fail) {
    this.#connection = connection;
    this.#fail = fail;
    $("speed").oninput = () => this.#speed();
    this.#speed();
    // Whatever takes the person's eyes away lets go of everything.
    window.addEventListener("blur", () => this.letGo());
    document.addEventListener("visibilitychange", () => document.hidden && this.letGo());
    connection.addEventListener("closed", () => this.letGo());
    connection.addEventListener("refused", ({ detail }) => {
      this.letGo();
      fail(detail.error);
    });
  }

  /** µm/s, from 1 to 3,000 along the slider. */
  #speed() {
    const speed = 10 ** (Number($("speed").value) * Math.log10(3000));
    const rounded = speed < 10 ? Math.round(speed * 10) / 10 : Math.round(speed);
    say($("speed-value"), `${rounded} µm/s`);
    return rounded;
  }

  show(state) {
    const names = state.axes.map((axis) => axis.name).join();
    if (names !== [...this.#rows.keys()].join()) this.#build(state.axes);
    for (const axis of state.axes) {
      const row = this.#rows.get(axis.name);
      const known = axis.position_um !== null;
      // Only the text changes: a click on an element that was replaced meanwhile would be lost.
      say(row.value, known ? axis.position_um.toFixed(2) : "–");
      const title = `${axis.name}: ${axis.low_um} to ${axis.high_um} µm, position ${axis.trust}. Click to type where to go.`;
      if (row.place.title !== title) row.place.title = title;
      const share = known ? (axis.position_um - axis.low_um) / (axis.high_um - axis.low_um) : 0;
      row.needle.style.left = `${100 * Math.min(1, Math.max(0, share))}%`;
      row.row.classList.toggle("moving", axis.moving);
      row.row.classList.toggle("lost", axis.trust === "lost");
      row.row.classList.toggle("limit", share <= 0.0005 || share >= 0.9995 || axis.at_low || axis.at_high);
      row.limits.title = `${axis.low_um} … ${axis.high_um} µm`;
      row.top = axis.speed_um_s;
    }
  }

  enable(on) {
    for (const { buttons } of this.#rows.values()) for (const button of buttons) button.disabled = !on;
    if (!on) this.letGo();
  }

  #build(axes) {
    this.#rows.clear();
    this.#devices = [...new Set(axes.map((axis) => axis.name.split(".")[0]))];
    $("axes").replaceChildren(...this.#devices.map((device, i) => {
      const own = axes.filter((axis) => axis.name.startsWith(`${device}.`));
      const name = NAMES[device] ?? `Manipulator ${device.slice(1)}`;
      return element("div", { class: "device", id: `device-${device}` },
        element("button", { type: "button", onclick: () => this.choose(device) }, name, element("kbd", {}, String(i + 1))),
        ...own.map((axis) => this.#row(axis)));
    }));
    this.choose(this.#devices.includes(this.chosen) ? this.chosen : this.#devices[0]);
  }

  #row(axis) {
    const button = (sign, text) => {
      const made = element("button", { type: "button", id: `jog-${axis.name}-${sign > 0 ? "up" : "down"}`, "aria-label": `${axis.name} ${sign > 0 ? "up" : "down"}, while held` }, text);
      made.addEventListener("pointerdown", (event) => {
        if (event.button !== 0 || made.disabled) return;
        made.setPointerCapture(event.pointerId);
        this.hold(axis.name, sign, made);
      });
      const end = () => this.release(axis.name);
      for (const type of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) made.addEventListener(type, end);
      made.addEventListener("keydown", (event) => {
        if (event.key === "Enter" && !event.repeat) this.hold(axis.name, sign, made);
      });
      made.addEventListener("keyup", (event) => event.key === "Enter" && end());
      made.addEventListener("contextmenu", (event) => event.preventDefault());
      return made;
    };
    const value = element("span", {});
    const place = element("button", {
      type: "button", class: "place", id: `place-${axis.name}`, onclick: () => this.#type(axis.name),
    }, value, element("small", {}, " µm"));
    const needle = element("i");
    const limits = element("div", { class: "travel" }, needle);
    const buttons = [button(-1, "−"), button(1, "+")];
    const row = element("div", { class: "axis" },
      element("span", { class: "name" }, axis.name.split(".")[1]), buttons[0], limits, buttons[1], place);
    this.#rows.set(axis.name, { row, place, value, needle, limits, buttons, top: axis.speed_um_s });
    return row;
  }

  /** Lets the person type where an axis shall go. */
  #type(name) {
    const { row, place } = this.#rows.get(name);
    const input = element("input", { type: "text", inputmode: "decimal", "aria-label": `${name} to, µm`, value: this.#rows.get(name).value.textContent.replace("–", "") });
    let open = true;
    // Taking the field away makes it lose the keyboard, which would take it away again.
    const back = () => {
      if (open) {
        open = false;
        input.replaceWith(place);
      }
    };
    input.addEventListener("keydown", async (event) => {
      event.stopPropagation();
      if (event.key === "Escape") back();
      if (event.key !== "Enter") return;
      const to = Number(input.value.replace(",", "."));
      back();
      if (!Number.isFinite(to)) return this.#fail(`'${input.value}' is no number`);
      this.#connection.post("move", { to_um: { [name]: to } }).catch((error) => this.#fail(error.message));
    });
    input.addEventListener("blur", back);
    row.replaceChild(input, place);
    input.focus();
    input.select();
  }

  choose(device) {
    this.chosen = device;
    for (const other of this.#devices) $(`device-${other}`).classList.toggle("chosen", other === device);
  }

  /** The n-th device. */
  chooseNth(n) {
    if (this.#devices[n]) this.choose(this.#devices[n]);
  }

  get devices() {
    return this.#devices;
  }

  /** Keeps an axis moving until released; it stops by itself when this page falls silent. */
  hold(axis, sign, button = null, slow = false) {
    const row = this.#rows.get(axis);
    if (!row || !this.#connection.yours) return;
    this.#held.get(axis)?.button?.classList.remove("held");
    button?.classList.add("held");
    this.#held.set(axis, { sign, button, slow });
    this.#ask();
    this.#timer ??= setInterval(() => this.#ask(), EVERY_MS);
  }

  #ask() {
    for (const [axis, { sign, slow }] of this.#held) {
      const speed = Math.min(this.#speed() * (slow ? 0.1 : 1), this.#rows.get(axis).top);
      this.#connection.jog(axis, sign * speed);
    }
  }

  release(axis) {
    const held = this.#held.get(axis);
    if (!held) return;
    this.#held.delete(axis);
    held.button?.classList.remove("held");
    this.#connection.jog(axis, 0);
    if (this.#held.size === 0) {
      clearInterval(this.#timer);
      this.#timer = null;
    }
  }

  letGo() {
    for (const axis of [...this.#held.keys()]) this.release(axis);
  }
}
