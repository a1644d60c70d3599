import { setNotice } from "../state/notices";
import type { PageStore } from "./part";

/** Puts a message of the view where the user sees it; an empty text takes it away. */
export function notice(store: PageStore, key: string, text: string): void {
  setNotice(store, `view:${key}`, text);
}

/** Takes away every message of the view whose key begins so. */
export function clearNotices(store: PageStore, prefix: string): void {
  const notices = store.state.notices;
  const left = notices.filter((one) => !one.key.startsWith(`view:${prefix}`));
  if (left.length < notices.length) store.set({ notices: left });
}
