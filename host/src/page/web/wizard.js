// Calibration, step by step: what to do next in words, clicks as samples, residuals over the picture.

import { $, element, say } from "./dom.js";

/** Arrows from a sample to where the solution has it are drawn this much longer. */
const LONGER = 10;

export class Wizard {
  #connection;
  #fail;
  #drawn = "";
  #title = "";
  #step = "camera";
  #detector = false;
  #places = 6;
  #within = 25;

  constructor(connection, fail) {
    this.#connection = connection;
    this.#fail = fail;
  }

  #post(path, body = {}) {
    return this.#connection.post(`calibration/${path}`, body).catch((error) => this.#fail(error.message));
  }

  /** A click in the picture, while a question is asked. */
  click(at) {
    this.#post("answer", at);
  }

  /** Whether a click answers a question now. */
  asks(state) {
    return Boolean(state?.calibration?.asked) && this.#connection.yours;
  }

  hint(state) {
    const asked = state.calibration?.asked;
    if (!asked) return "";
    return `Click on ${asked.subject}${asked.expected ? ", near the circle" : ""}. Zoom in first: half a pixel counts.`;
  }

  marks(state) {
    const calibration = state.calibration;
    if (!calibration) return [];
    const samples = calibration.samples.map((sample, i) => {
      const [x, y] = sample.at_px;
      const to = sample.solved_px && [x + LONGER * (sample.solved_px[0] - x), y + LONGER * (sample.solved_px[1] - y)];
      return { x, y, to, kind: sample.undone ? "undone" : sample.outlier ? "outlier" : "sample", text: String(i + 1) };
    });
    const expected = calibration.asked?.expected;
    if (expected) samples.push({ x: expected[0], y: expected[1], kind: "expected", text: "here?" });
    return samples;
  }

  show(state) {
    const yours = this.#connection.yours;
    const idle = state.activity.doing === "idle";
    const now = JSON.stringify([state.calibration, state.calibrated, yours, idle, this.#step, this.#detector, this.#places, this.#within]);
    if (now === this.#drawn) return;
    this.#drawn = now;
    const held = document.activeElement?.closest("#calibration") ? document.activeElement.id : null;
    const panel = state.calibration ? this.#running(state.calibration, yours) : this.#choice(state, yours && idle);
    $("calibration").replaceChildren(element("div", { class: "title" }, element("h2", {}, "Calibration")), ...panel);
    if (held) $(held)?.focus();
    const title = state.calibration?.title ?? "";
    if (title && title !== this.#title) $("calibration").scrollIntoView({ block: "start" });
    this.#title = title;
  }

  #choice(state, ready) {
    const { calibrated } = state;
    const manipulators = [...new Set(state.axes.map((axis) => axis.name.split(".")[0]))].filter((name) => name !== "scope");
    const done = (name) => (name === "camera" ? calibrated.camera : calibrated.manipulators.includes(name));
    const steps = ["camera", ...manipulators, "coarse"];
    if (!steps.includes(this.#step)) this.#step = "camera";
    const tab = (name) => element("button", {
      type: "button", role: "tab", id: `step-${name}`, "aria-selected": String(name === this.#step), class: "step",
      onclick: () => {
        this.#step = name;
        this.show(this.#connection.state);
      },
    }, `${done(name) ? "✓ " : ""}${name === "camera" ? "Camera" : name === "coarse" ? "Coarse" : `Tip ${name}`}`);
    return [
      element("div", { class: "group", role: "tablist" }, ...steps.map(tab)),
      ...(this.#step === "coarse" ? coarse() : this.#begin(ready, done("camera"))),
    ];
  }

  #begin(ready, camera) {
    const step = this.#step;
    const list = step === "camera" ? [
      "Bring a point that does not move – a speck, or a pipette's tip – near the middle of the picture, and focus on it.",
      "Begin. The microscope goes to several places; at each one you click the same point.",
      "It focuses by itself, stays near, and comes back.",
    ] : [
      `Bring the tip of ${step} near the middle of the picture, within 20 µm of focus, with nothing in its way.`,
      `Begin. ${step} moves a little in each direction and is focused every time; click exactly on its tip.`,
      "The more is known, the better the circle says where the tip should be. Pass where you cannot see it.",
    ];
    const blocked = step !== "camera" && !camera;
    const places = element("input", {
      type: "number", id: "places", min: "3", max: "40", value: String(this.#places), "aria-label": "Places",
      onchange: ({ target }) => (this.#places = Math.min(40, Math.max(3, Math.round(Number(target.value) || 6)))),
    });
    const within = element("input", {
      type: "number", id: "within", min: "2", max: "200", value: String(this.#within), "aria-label": "How far the focus may be, µm",
      onchange: ({ target }) => (this.#within = Math.min(200, Math.max(2, Number(target.value) || 25))),
    });
    const detector = element("input", {
      type: "checkbox", id: "detector", checked: this.#detector,
      onchange: ({ target }) => (this.#detector = target.checked),
    });
    return [
      element("ol", { class: "how" }, ...list.map((text) => element("li", {}, text))),
      blocked ? element("p", { class: "fine" }, "The camera comes first: a tip's place is read off its picture.") : null,
      element("div", { class: "bar" },
        element("button", { type: "button", id: "begin", class: "main", disabled: !ready || blocked, onclick: () => this.#start() }, "Begin"),
        element("label", {}, places, " places"),
        element("label", {}, "focus within ", within, " µm"),
        element("label", {}, detector, " the program finds the tip")),
    ].filter(Boolean);
  }

  #start() {
    const camera = this.#step === "camera";
    const body = { what: camera ? "camera" : "registration", by: this.#detector ? "detector" : "click", places: this.#places, focus_within_um: this.#within };
    if (!camera) body.manipulator = this.#step;
    else if (this.#detector) body.manipulator = "m1";
    this.#post("start", body);
  }

  #running(calibration, yours) {
    const { samples } = calibration;
    const last = samples.findLastIndex((sample) => !sample.undone);
    const next = calibration.asked ? this.hint({ calibration }) : calibration.doing;
    const parts = [
      element("p", { class: "what" }, calibration.title, element("span", {}, `${samples.length} of ${calibration.of}`)),
      element("progress", { max: String(calibration.of), value: String(samples.length), "aria-label": "Samples" }),
      element("p", { id: "next", class: calibration.asked ? "asks" : "", role: "status", "aria-live": "polite" }, next),
    ];
    const buttons = [];
    if (calibration.asked) {
      buttons.push(element("button", { type: "button", id: "pass", disabled: !yours, onclick: () => this.#post("answer", { pass: true }) }, "Pass: it is not seen"));
    }
    if (last >= 0) {
      buttons.push(element("button", { type: "button", id: "undo", disabled: !yours, onclick: () => this.#post("undo", { sample: last }) }, `Undo sample ${last + 1}`));
    }
    if (!calibration.over) {
      buttons.push(element("button", { type: "button", id: "end", disabled: !yours, onclick: () => this.#connection.post("cancel", {}).catch((error) => this.#fail(error.message)) }, "End here"));
    }
    if (calibration.verdict) parts.push(element("p", { id: "verdict" }, calibration.verdict));
    if (calibration.over) {
      buttons.push(
        element("button", { type: "button", id: "accept", class: "main", disabled: !yours || !calibration.ready, onclick: () => this.#post("accept") }, "Use this calibration"),
        element("button", { type: "button", id: "discard", disabled: !yours, onclick: () => this.#post("discard") }, "Throw it away"));
    }
    if (samples.length) parts.push(this.#table(samples, yours));
    if (calibration.over && calibration.ready) parts.push(element("p", { class: "fine" }, `In the picture: arrows from each click to where the solution has it, ${LONGER} times as long.`));
    parts.splice(3, 0, element("div", { class: "bar" }, ...buttons));
    return parts;
  }

  #table(samples, yours) {
    const row = (sample, i) => element("tr", { class: sample.undone ? "undone" : sample.outlier ? "outlier" : "" },
      element("td", {}, String(i + 1)),
      element("td", {}, `${sample.at_px[0].toFixed(1)}, ${sample.at_px[1].toFixed(1)}`),
      element("td", {}, sample.residual_um === null ? "" : `${sample.residual_um.toFixed(2)} µm${sample.outlier ? ", left out" : ""}`),
      element("td", {}, element("button", {
        type: "button", id: `undo-${i}`, disabled: !yours, "aria-label": `${sample.undone ? "Take in" : "Undo"} sample ${i + 1}`,
        onclick: () => this.#post("undo", { sample: i, undone: !sample.undone }),
      }, sample.undone ? "Take in again" : "Undo")));
    return element("table", {}, element("thead", {}, element("tr", {}, ...["", "px", "residual", ""].map((text) => element("th", {}, text)))),
      element("tbody", {}, ...samples.map(row)));
  }
}

/** The stereo camera's pictures are files: the command does the rest. */
function coarse() {
  return [
    element("ol", { class: "how" },
      element("li", {}, "Coarse registration brings the tips into view when nothing is known. It needs a stereo camera and printed markers."),
      element("li", {}, "Take pairs of pictures from two or more places, then run ", element("code", {}, "parfocal calibrate coarse --help"), "."),
      element("li", {}, "docs/coarse.md shows every step, from printing the markers on.")),
  ];
}
