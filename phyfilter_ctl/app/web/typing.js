/** Values that are being typed: Esc takes them back, and until they are confirmed undo is the text's own. */

export class Typing {
  /** @param {HTMLElement} root */
  constructor(root) {
    this.root = root;
    /** @type {EventTarget | null} the input that is typed in */
    this.input = null;
    this.before = "";
    root.addEventListener("focusin", ({ target }) => {
      if (isText(target)) this.before = target.value;
    });
    root.addEventListener("input", ({ target }) => (this.input = target));
    root.addEventListener("change", ({ target }) => {
      this.input = null;
      // What was refused is taken back to what it was before.
      if (isText(target) && target.getAttribute("aria-invalid") !== "true") this.before = target.value;
    });
    root.addEventListener("keydown", (event) => this.takeBack(event), true);
    root.addEventListener("keydown", (event) => this.fold(event));
  }

  /** Whether a text that is being typed takes the keys of undo itself. @param {EventTarget} target */
  edits(target) {
    return isText(target) && target.value !== target.defaultValue && this.input === target;
  }

  /** @param {KeyboardEvent} event */
  takeBack(event) {
    const { target } = event;
    if (event.key !== "Escape" || event.isComposing || !isText(target) || target.value === this.before) return;
    event.preventDefault();
    event.stopPropagation();
    target.value = this.before;
    target.removeAttribute("aria-invalid");
    target.select();
    this.input = null;
  }

  /** Close what has a button for that. @param {KeyboardEvent} event */
  fold(event) {
    if (event.key !== "Escape" || event.defaultPrevented) return;
    const open = [.../** @type {NodeListOf<HTMLElement>} */ (this.root.querySelectorAll("[data-esc]"))];
    open
      .filter((element) => element.checkVisibility())
      .at(-1)
      ?.click();
  }
}

/** @param {EventTarget | null} target @returns {target is HTMLInputElement} */
const isText = (target) => target instanceof HTMLInputElement && target.matches("input[type=text], input[type=number]");
