// A mark in the log and the end of the flight, where they are armed. Each is confirmed and has a name.
const SAID_MS = 15000;
const at = id => document.getElementById(id);

export class Acts {
  constructor() {
    this.said = null;
    at("acts").onsubmit = event => event.preventDefault();
    at("act-mark-do").onclick = () => {
      const number = at("act-number");
      if (!number.reportValidity()) return;
      const given = number.valueAsNumber;
      this.ask({act: "mark", number: given}, `Mark ${given}`, "Set a line in the log");
    };
    at("act-stop").onclick = () => this.ask({act: "stop"}, "Stop the flight", "Devices are stopped and the log is closed");
  }

  begin(armed) {
    at("acts").hidden = !armed.length;
    at("act-mark").hidden = !armed.includes("mark");
    at("act-stop").hidden = !armed.includes("stop");
  }

  end() { at("acts").hidden = true; }

  ask(act, name, what) {
    const who = at("act-who");
    who.setCustomValidity(who.value.trim() ? "" : "Say who asks: the log says it");
    if (!who.reportValidity()) return;
    const sure = at("act-sure");
    at("act-what").textContent = `${name}? ${what}, with the name ${who.value.trim()}.`;
    at("act-yes").textContent = name.toLowerCase();
    at("act-yes").onclick = () => this.send({...act, who: who.value.trim()});  // the dialog's close event may come late
    sure.showModal();
  }

  async send(act) {
    this.tell("asked ...");
    try {
      const response = await fetch("act", {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(act)});
      this.tell((await response.json()).said);
      if (response.ok && act.act === "mark") at("act-number").stepUp();
    } catch {
      this.tell("no answer: see the events");
    }
  }

  tell(text) {
    at("act-said").textContent = text;
    clearTimeout(this.said);
    this.said = setTimeout(() => { at("act-said").textContent = ""; }, SAID_MS);
  }
}
