import type { Cameras } from "../link/cameras";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { isShown, whenShown } from "./shown";
import { button, el, keyedList, type ListItem } from "./dom";

/** Cameras that are shown at once: each takes a share of the network. */
const MAX_TILES = 6;

/** Create the panel of cameras: a tile for each topic of compressed pictures. */
export function camerasSection({ cameras, store }: PanelContext): HTMLElement {
  const tiles = el("ul", { class: "cameras", testid: "cameras" });
  const empty = el("p", { class: "hint", testid: "cameras-empty", text: t("cameras.empty") });
  const showTiles = keyedList<string>(tiles, String, (topic) => cameraTile(cameras, topic));
  const look = async (): Promise<void> => {
    if (!store.state.link.connected) return;
    try {
      const topics = await cameras.topics();
      showTiles(topics.slice(0, MAX_TILES));
      empty.hidden = topics.length > 0;
    } catch {
      // The connection is gone; the next look comes with the next one.
    }
  };
  const box = el("div", {}, empty, tiles, button(t("cameras.look"), "cameras-look", () => void look()));
  whenShown(box, () => void look());
  store.subscribe((state) => state.link.connected, () => isShown(box) && void look());
  return box;
}

/** Create the tile of a camera, which asks for pictures only while it is seen. */
function cameraTile(cameras: Cameras, topic: string): ListItem<string> {
  const picture = el("img", { testid: `camera-${topic}`, attributes: { alt: topic } });
  const element = el("li", {}, picture, el("span", { text: topic }));
  let end: (() => void) | null = null;
  const show = (): void => {
    end ??= cameras.watch(topic, (url) => {
      picture.src = url;
      if (isShown(element)) return;
      end?.();
      end = null;
    });
  };
  return { element, show };
}
