/** The size of an element, asked for after changes only: to ask lays out the page, and every frame of a drag needs it. */

export class Size {
  /** @param {HTMLElement} element */
  constructor(element) {
    this.element = element;
    this.known = { width: 0, height: 0 };
    this.changed = true;
    new ResizeObserver(() => (this.changed = true)).observe(element);
  }

  /** In px; 0 while it is not shown. */
  read() {
    if (!this.changed) return this.known;
    const { clientWidth: width, clientHeight: height } = this.element;
    this.known = { width, height };
    this.changed = !width || !height;
    return this.known;
  }
}
