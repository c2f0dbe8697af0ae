// Keys that go to a page, `g` and then the letter in its data-key, and `?` that lists them. They can be switched off in
// the list, and they never act while something is typed. None of them changes anything.

const WAIT_MS = 1500;
const STORED = "boresight-keys";
const list = document.getElementById("keys");
const opener = document.getElementById("keys-open");
const onSwitch = document.getElementById("keys-on");
let goAt = -WAIT_MS;

const isOn = () => localStorage.getItem(STORED) !== "off";
const isTyping = (target) => target.closest("input, textarea, select, [contenteditable]") !== null;

function show() {
  onSwitch.checked = isOn();
  list.showModal();
}

function go(key) {
  const link = document.querySelector(`nav.side a[data-key="${CSS.escape(key)}"]`);
  if (link) location.assign(link.href);
}

function press(event) {
  if (!isOn() || event.ctrlKey || event.altKey || event.metaKey || isTyping(event.target) || list.open) return;
  const waiting = event.timeStamp - goAt < WAIT_MS; // when the keys were pressed, however busy the page was meanwhile
  goAt = event.key === "g" ? event.timeStamp : -WAIT_MS;
  if (event.key === "?") show();
  else if (waiting && event.key !== "g") go(event.key);
}

if (list) {
  opener.hidden = false;
  opener.addEventListener("click", show);
  onSwitch.addEventListener("change", () => localStorage.setItem(STORED, onSwitch.checked ? "on" : "off"));
  document.addEventListener("keydown", press);
}
