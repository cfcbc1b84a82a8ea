// The way to the server: one WebSocket for what there is to see, HTTP for what is to be done.

const KEY = "parfocal-key";
/** A tab that has the same key answers within this time, if it can. */
const TWIN_MS = 200;

export class Connection extends EventTarget {
  #socket = null;
  #wait = 250;
  /** A duplicated tab is given a copy of the other's key; the tabs of this browser tell each other. */
  #tabs = new BroadcastChannel("parfocal-operator");
  key = sessionStorage.getItem(KEY) ?? "";
  yours = false;
  open = false;
  state = null;

  async start() {
    let asking = this.key;
    this.#tabs.onmessage = ({ data }) => {
      if (data.asks && data.asks === this.key) this.#tabs.postMessage({ held: this.key });
      // The copy gives way, however late it hears of the other; what it takes by itself later is its own.
      if (data.held && data.held === asking && data.held === this.key) {
        asking = "";
        this.#keep("");
        this.#control(false);
      }
    };
    if (this.key) {
      this.#tabs.postMessage({ asks: this.key });
      await new Promise((done) => setTimeout(done, TWIN_MS));
    }
    this.#connect();
    setInterval(() => this.#here(), 2000);
  }

  #connect() {
    const socket = new WebSocket(`ws://${location.host}/api/live`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#wait = 250;
      this.open = true;
      this.#here();
      this.#tell("open");
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.#heard(JSON.parse(data)) : this.#picture(data));
    socket.onclose = ({ reason }) => {
      if (this.#socket !== socket) return;
      this.open = false;
      this.#tell("closed", reason);
      setTimeout(() => this.#connect(), this.#wait);
      this.#wait = Math.min(2 * this.#wait, 4000);
    };
  }

  #tell(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  #heard(message) {
    if (message.type === "state") this.state = message;
    if (message.type === "control") this.#control(message.yours);
    this.#tell(message.type, message);
  }

  #control(yours) {
    if (this.yours === yours) return;
    this.yours = yours;
    if (!yours) this.#keep("");
    this.#tell("operator", yours);
  }

  #picture(data) {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    this.#tell("picture", { header, jpeg: new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }) });
  }

  #here() {
    if (this.key) this.send({ type: "here", key: this.key });
  }

  #keep(key) {
    this.key = key;
    if (key) sessionStorage.setItem(KEY, key);
    else sessionStorage.removeItem(KEY);
  }

  /** Says something over the WebSocket, if it is open. */
  send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  /** Asks for control; `force` takes it from another operator. */
  async take(force) {
    const { key } = await this.post("control", { name: operatorName(), force });
    this.#keep(key);
    this.#control(true);
    this.#here();
  }

  async release() {
    await this.#ask("DELETE", "control");
    this.#control(false);
  }

  /** Keeps an axis moving for a moment; 0 lets go. */
  jog(axis, speed) {
    this.send({ type: "jog", key: this.key, axis, speed_um_s: speed });
  }

  /** Stops everything, by both ways: whichever is faster. */
  stop() {
    this.send({ type: "stop" });
    return this.post("stop", {});
  }

  post(path, body) {
    return this.#ask("POST", path, body);
  }

  async #ask(method, path, body) {
    let answer;
    try {
      answer = await fetch(`/api/${path}`, {
        method,
        headers: { "content-type": "application/json", "x-parfocal-key": this.key },
        body: body === undefined ? undefined : JSON.stringify(body),
      });
    } catch {
      throw new Error("the program does not answer: is parfocal serve still running?");
    }
    const said = await answer.json().catch(() => ({ error: `the program answered ${answer.status}` }));
    if (!answer.ok) throw new Error(said.error);
    return said;
  }
}

/** What other people read while this page has control. */
function operatorName() {
  const system = navigator.userAgentData?.platform ?? /\(([^;)]+)/.exec(navigator.userAgent)?.[1] ?? "";
  return `the page in another window${system ? ` (${system})` : ""}`.slice(0, 60);
}
