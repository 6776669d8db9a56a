/** The designer as a page. */

import designer from "./designer.js";
import { PageModel, readToken } from "./page_model.js";
import { nameOfTab, Shelf } from "./page_shelf.js";

const el = /** @type {HTMLElement} */ (document.getElementById("designer"));
const token = readToken();
if (token) {
  const { tab, from } = await nameOfTab();
  const shelf = new Shelf(tab);
  const model = new PageModel(token, tab, shelf);
  if (from && !model.session) model.session = shelf.read(from);
  designer.render({ model, el });
} else {
  el.id = "refused";
  el.textContent = "This page needs the whole address that phyfilter-ctl app printed, with its token at the end.";
}
