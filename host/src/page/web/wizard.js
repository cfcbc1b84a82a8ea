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
  /** Which objectives are to be calibrated. */
  #through = new Map();

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
    return state?.calibration?.asked?.for === "point" && this.#connection.yours;
  }

  hint(state) {
    const asked = state.calibration?.asked;
    if (!asked) return "";
    if (asked.for === "objective") {
      return state.calibrated?.turret ? `Next: objective ${asked.subject}. Look that its way is free; the button turns the turret.`
        : `Put objective ${asked.subject} into the light path, with nothing in its way, then say so.`;
    }
    return `Click on ${asked.subject}${asked.expected ? ", near the circle" : ""}. Zoom in first: half a pixel counts.`;
  }

  marks(state) {
    const calibration = state.calibration;
    if (!calibration) return [];
    const samples = calibration.samples.map((sample, i) => {
      // Seen through another objective it would lie elsewhere in this picture.
      if (sample.objective !== state.calibrated.objective) return null;
      const [x, y] = sample.at_px;
      const to = sample.solved_px && [x + LONGER * (sample.solved_px[0] - x), y + LONGER * (sample.solved_px[1] - y)];
      return { x, y, to, kind: sample.undone ? "undone" : sample.outlier ? "outlier" : "sample", text: String(i + 1) };
    }).filter(Boolean);
    const expected = calibration.asked?.expected;
    if (expected) samples.push({ x: expected[0], y: expected[1], kind: "expected", text: "here?" });
    return samples;
  }

  show(state) {
    const yours = this.#connection.yours;
    const idle = state.activity.doing === "idle";
    const now = JSON.stringify([state.calibration, state.calibrated, yours, idle, this.#step, this.#detector, this.#places, this.#within, [...this.#through]]);
    if (now === this.#drawn) return;
    this.#drawn = now;
    const held = document.activeElement?.closest("#calibration") ? document.activeElement.id : null;
    const panel = state.calibration ? this.#running(state, yours) : this.#choice(state, yours && idle);
    $("calibration").replaceChildren(element("div", { class: "title" }, element("h2", {}, "Calibration")), ...panel);
    if (held) $(held)?.focus();
    // What is on the screen now, for who drives this page by a program.
    Object.assign($("calibration").dataset, { question: state.calibration?.asked?.n ?? 0, over: Boolean(state.calibration?.over) });
    const title = state.calibration?.title ?? "";
    if (title && title !== this.#title) $("calibration").scrollIntoView({ block: "start" });
    this.#title = title;
  }

  #choice(state, ready) {
    const { calibrated } = state;
    const manipulators = [...new Set(state.axes.map((axis) => axis.name.split(".")[0]))].filter((name) => name !== "scope");
    const calibrated_objectives = calibrated.objectives.filter((objective) => objective.alpha !== null);
    const done = (name) => (name === "camera" ? calibrated.camera : name === "coarse" ? calibrated.coarse.length > 0
      : name === "objective" ? calibrated_objectives.length > 1 : calibrated.manipulators.includes(name));
    const names = { camera: "Camera", coarse: "Coarse", objective: "Objectives" };
    const steps = ["camera", ...manipulators, "objective", "coarse"];
    if (!steps.includes(this.#step)) this.#step = "camera";
    const choose = (name, focus) => {
      this.#step = name;
      this.show(this.#connection.state);
      if (focus) $(`step-${name}`)?.focus();
    };
    const tab = (name) => element("button", {
      type: "button", role: "tab", id: `step-${name}`, "aria-selected": String(name === this.#step), class: "step",
      tabindex: name === this.#step ? "0" : "-1", "aria-controls": "step",
      onclick: () => choose(name, false),
      onkeydown: (event) => {
        const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
        if (by) choose(steps[(steps.indexOf(name) + by + steps.length) % steps.length], true);
      },
    }, `${done(name) ? "✓ " : ""}${names[name] ?? `Tip ${name}`}`);
    const panel = this.#step === "coarse" ? this.#coarse(calibrated, ready)
      : this.#step === "objective" ? this.#objectives(calibrated, ready) : this.#begin(ready, done("camera"));
    return [
      element("div", { class: "group", role: "tablist", "aria-label": "Steps" }, ...steps.map(tab)),
      element("div", { id: "step", role: "tabpanel", "aria-labelledby": `step-${this.#step}` }, ...panel),
    ];
  }

  /** Objectives against the default one. */
  #objectives(calibrated, ready) {
    const { objectives } = calibrated;
    const first = objectives.find((objective) => objective.default);
    const others = objectives.filter((objective) => !objective.default);
    for (const { name } of others) if (!this.#through.has(name)) this.#through.set(name, objectives.length < 3 || calibrated.objective === name);
    const chosen = others.filter(({ name }) => this.#through.get(name)).map(({ name }) => name);
    const box = ({ name, alpha }) => element("label", { class: "choice" },
      element("input", {
        type: "checkbox", id: `through-${name}`, checked: this.#through.get(name),
        onchange: ({ target }) => {
          this.#through.set(name, target.checked);
          this.show(this.#connection.state);
        },
      }), ` ${name}`, element("span", {}, alpha === null ? "not calibrated" : `α ${alpha.toFixed(4)}`));
    const added = element("input", { type: "text", id: "objective-name", maxlength: "40", placeholder: "10x", "aria-label": "Name of another objective" });
    const blocked = !calibrated.camera ? "The camera comes first, with the default objective."
      : others.length === 0 ? "Add the other objective by its name. That says it is in the light path now."
        : chosen.length === 0 ? "Choose at least one objective." : null;
    return [
      element("ol", { class: "how" },
        element("li", {}, `Bring a point that does not move near the middle of the picture, in focus, through ${first ? `the default objective, ${first.name}` : "the default objective"}.`),
        element("li", {}, "Begin. The same point is seen from several places through each objective; the page says when to change it."),
        element("li", {}, "Change objectives only when asked, and look that no pipette is in the way.")),
      element("div", { class: "choices" }, ...others.map(box)),
      blocked ? element("p", { class: "fine" }, blocked) : null,
      element("div", { class: "bar" },
        element("button", {
          type: "button", id: "begin", class: "main", disabled: !ready || Boolean(blocked),
          onclick: () => this.#start({ what: "objective", through: chosen }),
        }, "Begin"), ...this.#fields()),
      calibrated.turret ? null : element("div", { class: "bar" }, element("label", {}, "another ", added),
        element("button", {
          type: "button", id: "objective-add", disabled: !ready,
          onclick: () => this.#connection.post("objective", { name: added.value.trim(), new: true }).catch((error) => this.#fail(error.message)),
        }, "Add: it is in the light path")),
    ].filter(Boolean);
  }

  /** What the printed markers say, and tips brought into view by it. */
  #coarse(calibrated, ready) {
    const { coarse: known, markers, objectives } = calibrated;
    const through = objectives.filter((objective) => objective.alpha !== null).sort((a, b) => b.alpha - a.alpha).map(({ name }) => name);
    const code = (text) => element("code", {}, text);
    const row = ({ name, error_um, error_deg, date }) => element("tr", {},
      element("td", {}, name), element("td", {}, `± ${error_um.toFixed(error_um < 10 ? 1 : 0)} µm`), element("td", {}, `± ${error_deg.toFixed(2)}°`),
      element("td", {}, date.slice(0, 10)),
      element("td", {}, element("button", {
        type: "button", id: `into-view-${name}`, disabled: !ready || !calibrated.camera || !through.length,
        onclick: () => this.#start({ what: "into-view", manipulator: name, through, by: "detector" }),
      }, "Into view")));
    const steps = [
      element("li", {}, "Print the markers and fix one on the substrate, on each manipulator and on the objective: ", code("parfocal calibrate coarse --help"), ", docs/coarse.md."),
      element("li", {}, "Take pairs of pictures with the stereo camera from two or more places, and let the command solve them: it keeps what it finds in the rig's file."),
      element("li", {}, "Here, each tip is then brought into view: searched through the weakest objective, handed on to the next, focused in the last."),
    ];
    const said = !calibrated.kept_in ? "Start the program with --rig FILE: the markers are known by the rig's file."
      : !markers.length ? "The rig's file knows of no markers yet."
        : `Markers: ${markers.map(([body, id]) => `${body} ${id}`).join(", ")}. ${calibrated.stereo ? "The stereo camera is calibrated." : "The stereo camera is not calibrated yet."}`;
    return [
      element("ol", { class: "how" }, ...steps),
      element("p", { class: "fine", id: "markers" }, said),
      known.length ? element("table", { id: "coarse-known" }, element("thead", {}, element("tr", {}, ...["", "tip", "direction", "of", ""].map((text) => element("th", {}, text)))),
        element("tbody", {}, ...known.map(row))) : element("p", { class: "fine" }, "No manipulator has a coarse registration."),
      known.length ? element("p", { class: "fine" }, `Through ${through.join(", then ") || "no calibrated objective"}. Pipettes move by themselves: watch, with STOP at hand.`) : null,
    ].filter(Boolean);
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
    return [
      element("ol", { class: "how" }, ...list.map((text) => element("li", {}, text))),
      blocked ? element("p", { class: "fine" }, "The camera comes first: a tip's place is read off its picture.") : null,
      element("div", { class: "bar" },
        element("button", {
          type: "button", id: "begin", class: "main", disabled: !ready || blocked,
          onclick: () => this.#start(step === "camera" ? { what: "camera" } : { what: "registration", manipulator: step }),
        }, "Begin"), ...this.#fields()),
    ].filter(Boolean);
  }

  /** What every procedure asks for. */
  #fields() {
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
      element("label", {}, places, " places"),
      element("label", {}, "focus within ", within, " µm"),
      element("label", {}, detector, " the program finds the tip"),
    ];
  }

  #start(what) {
    const body = { by: this.#detector ? "detector" : "click", places: this.#places, focus_within_um: this.#within, ...what };
    // The detector knows tips only.
    if (body.by === "detector") body.manipulator ??= "m1";
    this.#post("start", body);
  }

  #running({ calibration, calibrated }, yours) {
    const { samples } = calibration;
    const last = samples.findLastIndex((sample) => !sample.undone);
    const next = calibration.asked ? this.hint({ calibration, calibrated }) : calibration.doing;
    const parts = [
      element("p", { class: "what" }, calibration.title, element("span", {}, `${samples.length} of ${calibration.of}`)),
      element("progress", { max: String(calibration.of), value: String(samples.length), "aria-label": "Samples" }),
      element("p", { id: "next", class: calibration.asked ? "asks" : "", role: "status", "aria-live": "polite" }, next),
    ];
    const buttons = [];
    if (calibration.asked?.for === "objective") {
      buttons.push(element("button", { type: "button", id: "changed", class: "main", disabled: !yours, onclick: () => this.#post("answer", { done: true }) },
        calibrated.turret ? `Turn to ${calibration.asked.subject}` : `${calibration.asked.subject} is in the light path`));
    }
    if (calibration.asked?.for === "point") {
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
    const several = new Set(samples.map((sample) => sample.objective)).size > 1;
    const row = (sample, i) => element("tr", { class: sample.undone ? "undone" : sample.outlier ? "outlier" : "" },
      element("td", {}, String(i + 1)),
      several ? element("td", {}, sample.objective ?? "") : null,
      element("td", {}, `${sample.at_px[0].toFixed(1)}, ${sample.at_px[1].toFixed(1)}`),
      element("td", {}, sample.residual_um === null ? "" : `${sample.residual_um.toFixed(2)} µm${sample.outlier ? ", left out" : ""}`),
      element("td", {}, element("button", {
        type: "button", id: `undo-${i}`, disabled: !yours, "aria-label": `${sample.undone ? "Take in" : "Undo"} sample ${i + 1}`,
        onclick: () => this.#post("undo", { sample: i, undone: !sample.undone }),
      }, sample.undone ? "Take in again" : "Undo")));
    return element("table", {}, element("thead", {}, element("tr", {}, ...["", ...(several ? ["through"] : []), "px", "residual", ""].map((text) => element("th", {}, text)))),
      element("tbody", {}, ...samples.map(row)));
  }
}
