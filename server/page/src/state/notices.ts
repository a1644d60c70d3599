import type { State } from "./state";
import type { Store } from "./store";

/** Tell the user something that stays until its cause is gone; an empty text takes it away. */
export function setNotice(store: Store<State>, key: string, text: string): void {
  const { notices } = store.state;
  if ((notices.find((notice) => notice.key === key)?.text ?? "") === text) return;
  const others = notices.filter((notice) => notice.key !== key);
  store.set({ notices: text === "" ? others : [...others, { key, text }] });
}
