/**
 * Numbers as the server writes them (verdicts/numbers.py): digits parted by narrow spaces, a true minus, raised exponents.
 * Hovers of a figure write theirs so too: Plotly's own forms have other signs, and exponents where a table has none.
 */
const NARROW_SPACE = "\u202f";
export const MINUS = "\u2212";
const RAISED = "⁰¹²³⁴⁵⁶⁷⁸⁹";
const FORM = /^(\+?),?\.(\d+)([gf%])$/; // of d3: sign, decimals or digits, kind

/** @typedef {(value: number) => string} Write */

/** Part, sign and raise the digits of a number in JavaScript's own form; 0 has no sign. @param {string} text */
function grouped(text) {
  const [mantissa = "", exponent] = text.replace(/^-/, "").split("e");
  const [whole = "", rest] = mantissa.split(".");
  const sign = text.startsWith("-") && /[1-9]/.test(mantissa) ? MINUS : "";
  const decimals = rest === undefined ? "" : `.${rest}`;
  return `${sign}${whole.replace(/\B(?=(\d{3})+$)/g, NARROW_SPACE)}${decimals}${exponent ? `·10${raised(exponent)}` : ""}`;
}

/** @param {string} exponent */
const raised = (exponent) => exponent.replace("+", "").replace("-", "⁻").replace(/\d/g, (digit) => RAISED[Number(digit)] ?? digit);

/** To so many significant digits, from 10⁷ on and below 10⁻⁴ with a power of ten. @param {number} value @param {number} [digits] */
export function number(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const exponent = Math.floor(Math.log10(Math.abs(value)));
  return grouped(exponent >= -4 && exponent < 7 ? value.toFixed(Math.max(digits - 1 - exponent, 0)) : value.toExponential(digits - 1));
}

/** A whole number. @param {number} value */
export const count = (value) => grouped(value.toFixed(0));

/** What writes numbers in a form of d3, as `+.4g`; undefined of a form that no figure uses. @param {string} form @returns {Write | undefined} */
export function formatter(form) {
  const [found, sign, digits, kind] = FORM.exec(form) ?? [];
  if (!found) return undefined;
  /** @type {Write} */
  const write = (value) => {
    if (!Number.isFinite(value)) return "–";
    if (kind === "g") return number(value, Number(digits));
    return grouped((kind === "%" ? 100 * value : value).toFixed(Number(digits))) + (kind === "%" ? `${NARROW_SPACE}%` : "");
  };
  return (value) => `${sign && value > 0 ? sign : ""}${write(value)}`;
}

/** @type {WeakSet<object>} */
const taught = new WeakSet();

/** Let the hovers of a drawn figure write numbers so, by the locale that Plotly makes again at each drawing. @param {{ numberFormat: (form: string) => Write } | undefined} locale */
export function writeNumbersIn(locale) {
  if (!locale || taught.has(locale)) return;
  taught.add(locale);
  const theirs = locale.numberFormat;
  locale.numberFormat = (form) => formatter(form) ?? theirs(form);
}
