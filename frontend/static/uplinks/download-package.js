/** Exporting gives the package at once: the page that follows says that it is built, once, and fetches it. */
import { find } from "../shared/dom.js";

if (find('[data-code="package"]', HTMLElement)) find("#download-package", HTMLAnchorElement)?.click();
