/** What the browser keeps for the page: one session for every tab, in the storage of this address. */

const TAB = "phyfilter-tab";
const PREFIX = "phyfilter-session ";
const MOST = 20; // sessions that are kept
const LONGEST = 60 * 24 * 3600e3; // ms
const TURN = 400; // ms: a page that is being left has let go of its tab's name by then

/**
 * The name of this tab. It outlives a reload; a tab that was duplicated gets a name of its own, and its work with it.
 * @returns {Promise<{tab: string, from: string | null}>} from: the tab that it was duplicated from
 */
export async function nameOfTab() {
  const known = sessionStorage.getItem(TAB);
  if (known && (await held(known))) return { tab: known, from: null };
  const tab = newName();
  sessionStorage.setItem(TAB, tab);
  await held(tab);
  return { tab, from: known };
}

function newName() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Hold the name as long as the page lives; false where another page holds it. @param {string} tab @returns {Promise<boolean>} */
function held(tab) {
  if (!navigator.locks) return Promise.resolve(true);
  return new Promise((resolve) => {
    const lives = () => {
      resolve(true);
      return new Promise(() => {});
    };
    navigator.locks.request(PREFIX + tab, { signal: AbortSignal.timeout(TURN) }, lives).catch(() => resolve(false));
  });
}

export class Shelf {
  /** @param {string} tab */
  constructor(tab) {
    this.tab = tab;
  }

  /** The session of a tab, null for none. @param {string} [tab] */
  read(tab = this.tab) {
    return parsed(localStorage.getItem(PREFIX + tab))?.data ?? null;
  }

  /** Keep the session of this tab. Throws where the browser keeps nothing. @param {unknown} data */
  write(data) {
    const text = JSON.stringify({ at: Date.now(), data });
    for (;;) {
      try {
        localStorage.setItem(PREFIX + this.tab, text);
        return;
      } catch (error) {
        const oldest = this.all().filter(({ tab }) => tab !== this.tab)[0];
        if (!oldest) throw error;
        this.drop(oldest.tab);
      }
    }
  }

  /** Keep the session of this tab under another name too, as that of a tab that was closed. */
  putAside() {
    const text = localStorage.getItem(PREFIX + this.tab);
    if (text) localStorage.setItem(PREFIX + newName(), text);
  }

  /** @param {string} tab */
  drop(tab) {
    localStorage.removeItem(PREFIX + tab);
  }

  /** All sessions, the oldest first; old ones and too many are let go of. */
  all() {
    const found = Object.keys(localStorage)
      .filter((key) => key.startsWith(PREFIX))
      .map((key) => ({ tab: key.slice(PREFIX.length), ...parsed(localStorage.getItem(key)) }))
      .sort((one, other) => one.at - other.at);
    const past = found.filter(({ at }, i) => !(Date.now() - at < LONGEST) || i < found.length - MOST);
    for (const { tab } of past) this.drop(tab);
    return found.slice(past.length);
  }

  /** Sessions of tabs that were closed, the newest first. @returns {Promise<{tab: string, at: number, data: any}[]>} */
  async left() {
    const locks = (await navigator.locks?.query())?.held?.map(({ name }) => name) ?? [PREFIX + this.tab];
    return this.all()
      .filter(({ tab }) => tab !== this.tab && !locks.includes(PREFIX + tab))
      .reverse();
  }
}

/** @param {string | null} text @returns {{at: number, data: any}} */
function parsed(text) {
  try {
    const { at, data } = JSON.parse(text ?? "{}");
    return { at: Number(at) || 0, data: data ?? null };
  } catch {
    return { at: 0, data: null };
  }
}
