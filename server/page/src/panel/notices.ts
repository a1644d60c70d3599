import { button, el } from "./dom";
import type { Page } from "./page";

/** What the user has to know until its cause is gone, or the user puts it away. */
export function notices({ store }: Page): HTMLElement {
  const list = el("ul", { class: "notices", testid: "notices", role: "alert" });
  const drop = (key: string): void => store.set({ notices: store.state.notices.filter((notice) => notice.key !== key) });
  store.subscribe(
    (state) => state.notices,
    (all) => {
      const items = all.map(({ key, text }) => {
        return el("li", {}, el("span", { text }), button("×", `drop-${key}`, () => drop(key), "Put this away"));
      });
      list.replaceChildren(...items);
    },
  );
  return list;
}
