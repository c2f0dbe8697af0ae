/** The theme that this browser kept gives way to the one that is chosen. The zone of this computer is proposed where none was chosen, and the choice of local time by whoever types one. */
import { need } from "../shared/dom.js";

const zone = need("#zone", HTMLInputElement);
zone.value ||= new Intl.DateTimeFormat().resolvedOptions().timeZone;
zone.addEventListener("input", () => (need("#form-local", HTMLInputElement).checked = true));
need("#theme-choice", HTMLSelectElement).addEventListener("change", () => localStorage.removeItem("boresight-theme"));
