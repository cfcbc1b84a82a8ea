// The page: what comes from the server goes to its parts, what the person does goes to the server.

import { Axes } from "./axes.js";
import { Connection } from "./connection.js";
import { Curve, Trace } from "./curve.js";
import { $, element, say } from "./dom.js";
import { Picture } from "./picture.js";
import { Wizard } from "./wizard.js";

const MEASURES = [
  "tenengrad", "normalised-variance", "variance", "brenner", "sum-modified-laplacian", "variance-of-laplacian",
  "energy-of-laplacian", "vollath-f4", "vollath-f5", "entropy", "range", "threshold-content", "wavelet-ratio",
];

const connection = new Connection();
let first = true;
let asked = false;
const own = [];
const fail = (text) => {
  own.push({ level: "error", text, at: connection.state?.messages.at(-1)?.n ?? 0 });
  if (own.length > 10) own.shift();
  messages(connection.state);
};
const attempt = (promise) => promise.catch((error) => fail(error.message));
const axes = new Axes(connection, fail);
const curve = new Curve();
const trace = new Trace();
const wizard = new Wizard(connection, fail);
const picture = new Picture(connection, (tool, at) => {
  if (tool === "click") wizard.click(at);
  else if (tool === "region") attempt(connection.post("look", { region: at }));
  else if (tool.startsWith("to-")) attempt(connection.post("click", { device: tool.slice(3), ...at }));
});

$("measure").replaceChildren(...MEASURES.map((name) => element("option", { value: name }, name)));
$("measure").onchange = () => attempt(connection.post("look", { measure: $("measure").value }));
$("objective").onchange = async () => {
  const name = $("objective").value;
  const question = connection.state.calibrated.turret ? `Turn the turret to ${name}? Look that no pipette is in its way.` : `Is objective ${name} in the light path? A wrong answer breaks pipettes.`;
  if (name && confirm(question)) await attempt(connection.post("objective", { name }));
  $("objective").blur();
  show(connection.state);
};
$("stop").onclick = () => attempt(connection.stop());
$("autofocus").onclick = autofocus;
$("cancel").onclick = () => attempt(connection.post("cancel", {}));
$("restart").onclick = () => attempt(connection.post("camera/restart", {}));
$("night").onclick = night;
$("control").onclick = () => {
  if (connection.yours) return attempt(connection.release());
  const other = connection.state?.operator;
  if (!other || confirm(`${other} has control. Taking it stops what moves. Take it?`)) attempt(connection.take(Boolean(other)));
};

function autofocus() {
  const range = Number($("range").value);
  const body = { axis: $("focus-axis").value };
  if ($("range").value !== "" && range > 0) body.range_um = [-range, range];
  attempt(connection.post("autofocus", body));
}

function night() {
  const on = document.documentElement.toggleAttribute("data-night");
  $("night").setAttribute("aria-pressed", String(on));
  localStorage.setItem("parfocal-night", on ? "1" : "");
}
if (localStorage.getItem("parfocal-night")) night();

connection.addEventListener("open", () => offline(false));
connection.addEventListener("closed", ({ detail }) => offline(true, detail));
connection.addEventListener("curve", ({ detail }) => curve.add(detail));
connection.addEventListener("operator", () => show(connection.state));
connection.addEventListener("state", ({ detail }) => {
  if (first && !connection.key && !detail.operator) attempt(connection.take(false));
  first = false;
  show(detail);
});

function offline(on, reason) {
  document.documentElement.toggleAttribute("data-offline", on);
  $("connection").className = on ? "pill bad" : "pill good";
  if (on) say($("connection"), "no connection");
  $("alarm").hidden = !on;
  say($("alarm"), on ? `The program does not answer${reason ? ` (${reason})` : ""}. What moved has stopped: it stops when it hears nothing. Trying again …` : "");
}

function show(state) {
  if (!state || !connection.open) return;
  const lost = state.problem ?? (state.boards.every((board) => board.connected) ? null : "a board is silent");
  const emergency = state.boards.some((board) => board.emergency);
  $("connection").className = `pill ${lost || emergency ? "bad" : "good"}`;
  say($("connection"), emergency ? "emergency stop" : lost ? "board lost" : state.simulated ? "simulated rig" : "connected");
  $("connection").title = lost ?? "";
  $("alarm").hidden = !(emergency || state.problem);
  say($("alarm"), emergency ? "Emergency stop: outputs are off and positions are not trusted until the axes are homed." : (state.problem ?? ""));
  say($("doing"), state.activity.text);
  say($("operator"), connection.yours ? "you have control" : state.operator ? `${state.operator} has control` : "nobody has control");
  say($("control"), connection.yours ? "Give back" : "Take control");
  const idle = state.activity.doing === "idle";
  const scanning = state.activity.doing === "autofocus";
  wizard.show(state);
  axes.show(state);
  axes.enable(connection.yours && (idle || state.activity.doing === "jog"));
  $("autofocus").disabled = !connection.yours || !idle;
  $("autofocus").hidden = scanning;
  $("cancel").hidden = !scanning;
  $("cancel").disabled = !connection.yours;
  $("measure").disabled = !connection.yours;
  if (document.activeElement !== $("measure")) $("measure").value = state.focus.measure;
  const focusing = state.axes.map((axis) => axis.name).filter((name) => name.endsWith(".z"));
  if ($("focus-axis").childElementCount !== focusing.length) {
    $("focus-axis").replaceChildren(...focusing.map((name) => element("option", { value: name }, name)));
  }
  objective(state, idle);
  trace.add(state.focus.value, state.focus.fault);
  curve.show(state);
  focusResult(state);
  camera(state);
  tools(state);
  const tips = state.tips.map((tip) => ({
    x: tip.x_px, y: tip.y_px, kind: "tip", text: `${tip.name}  ${tip.height_um >= 0 ? "+" : "−"}${Math.abs(tip.height_um).toFixed(1)} µm`,
  }));
  picture.mark([...tips, ...wizard.marks(state)]);
  messages(state);
}

function objective({ calibrated }, idle) {
  const select = $("objective");
  const names = calibrated.objectives.map(({ name }) => name);
  const text = (name) => `${name}${calibrated.objectives.find((o) => o.name === name)?.alpha === null ? " (not calibrated)" : ""}`;
  const options = [...(calibrated.objective ? [] : ["?"]), ...names];
  const wanted = options.map(text).join("\n");
  if (select.dataset.options !== wanted) {
    select.dataset.options = wanted;
    select.replaceChildren(...options.map((name) => element("option", { value: name === "?" ? "" : name }, text(name))));
  }
  select.disabled = !connection.yours || !idle;
  if (document.activeElement !== select) select.value = calibrated.objective ?? "";
}

function focusResult({ focus }) {
  $("focus-result").className = focus.refused ? "no" : "";
  const text = focus.refused ? `not focused: ${focus.refused}`
    : focus.focused_um !== null ? `${focus.axis} in focus at ${focus.focused_um.toFixed(2)} µm, ${focus.samples} samples`
    : focus.scan ? `${focus.samples} samples …` : "";
  say($("focus-result"), text);
}

function camera({ camera }) {
  say($("camera"), camera.health === "running" ? `${camera.name.slice(0, 40)}   ${camera.width_px}×${camera.height_px}, ${camera.bits} bits, ${camera.rate_hz.toFixed(0)} frames/s` : `the camera ${camera.health === "failed" ? "failed" : "is starting"}`);
  $("camera-problem").hidden = camera.health !== "failed";
  say($("camera-problem").firstElementChild, camera.problem ?? "");
  $("restart").disabled = !connection.yours;
}

/** What a click may do depends on what is calibrated. */
function tools(state) {
  const { calibrated } = state;
  const offered = { look: "Look", region: "Region" };
  const asks = wizard.asks(state);
  if (asks) offered.click = "Click the point";
  if (!calibrated.missing) {
    offered["to-scope"] = "Centre here";
    for (const name of calibrated.manipulators) offered[`to-${name}`] = `${name} tip here`;
  }
  picture.offer(offered);
  if (asks && !asked) picture.choose("click");
  asked = asks;
  const hints = { region: "Drag a rectangle around what shall be sharp; a click takes it away.", "to-scope": "Click what shall come to the centre." };
  const tip = picture.tool.startsWith("to-m") ? `Click where the tip of ${picture.tool.slice(3)} shall go, at the height in focus.` : "";
  say($("hint"), picture.tool === "click" ? wizard.hint(state) : (hints[picture.tool] ?? tip));
}

function messages(state) {
  const all = [...(state?.messages ?? []), ...own.map((message) => ({ ...message, n: message.at + 0.5 }))];
  const last = all.sort((a, b) => b.n - a.n).slice(0, 12);
  const text = last.map((message) => message.text).join("\n");
  if ($("messages").dataset.text === text) return;
  $("messages").dataset.text = text;
  $("messages").replaceChildren(...last.map((message) => element("li", { class: message.level }, message.text)));
}

// Keys. Space stops, whatever has the focus; everything else leaves fields alone.
const JOGS = { ArrowLeft: ["x", -1], ArrowRight: ["x", 1], ArrowUp: ["y", 1], ArrowDown: ["y", -1], PageUp: ["z", 1], PageDown: ["z", -1] };

window.addEventListener("keydown", (event) => {
  if (event.code === "Space" && !event.ctrlKey && !event.altKey && !event.metaKey) {
    event.preventDefault();
    event.stopImmediatePropagation();
    axes.letGo();
    if (!event.repeat) attempt(connection.stop());
    return;
  }
  const typing = event.target.matches?.("input:not([type=range]), select, textarea");
  const sliding = event.target.matches?.("input[type=range]") && event.key.startsWith("Arrow");
  if (typing || sliding || event.ctrlKey || event.altKey || event.metaKey) return;
  const jog = JOGS[event.key];
  if (jog) {
    event.preventDefault();
    if (!event.repeat) axes.hold(`${axes.chosen}.${jog[0]}`, jog[1], null, event.shiftKey);
    return;
  }
  const commands = {
    f: () => !$("autofocus").disabled && autofocus(), c: () => picture.cross(), n: night, r: () => picture.choose("region"),
    0: () => picture.fit(), "+": () => picture.zoom(1.25), "-": () => picture.zoom(0.8),
    Escape: () => (picture.tool !== "look" ? picture.choose("look") : !$("cancel").hidden && $("cancel").click()),
  };
  if (/^[1-9]$/.test(event.key)) axes.chooseNth(Number(event.key) - 1);
  else commands[event.key]?.();
}, true);
window.addEventListener("keyup", (event) => {
  // A button that has the focus would be clicked by the end of a Space.
  if (event.code === "Space") event.preventDefault();
  const jog = JOGS[event.key];
  if (jog) for (const device of axes.devices) axes.release(`${device}.${jog[0]}`);
}, true);

connection.start();
