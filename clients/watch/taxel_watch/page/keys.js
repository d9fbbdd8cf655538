// The keyboard.

const isTyping = (target) => target.matches?.("input:not([type=range]), select, textarea");

export function startKeys(page) {
  const dialog = document.getElementById("keys");
  const help = () => (dialog.open ? dialog.close() : dialog.showModal());
  document.getElementById("help").addEventListener("click", help);
  const actions = {
    " ": () => page.transport.toggle(),
    ArrowLeft: (event) => page.transport.step(event.shiftKey ? -100 : -1),
    ArrowRight: (event) => page.transport.step(event.shiftKey ? 100 : 1),
    Home: () => page.transport.to(0),
    End: () => page.transport.to(page.scene?.duration_s ?? 0),
    "[": () => page.pickElectrode(page.electrode - 1),
    "]": () => page.pickElectrode(page.electrode + 1),
    t: () => document.getElementById("theme").click(),
    "?": help,
  };
  document.addEventListener("keydown", (event) => {
    if (isTyping(event.target) || event.ctrlKey || event.metaKey || event.altKey) return;
    const finger = /^[1-9]$/.test(event.key) ? page.scene?.fingers[Number(event.key) - 1] : null;
    const action = finger ? () => page.pickFinger(finger.key) : actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action || (dialog.open && event.key !== "?")) return;
    event.preventDefault();
    action(event);
  });
}
