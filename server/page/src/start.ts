import { inspectable } from "./inspect";
import { hearControl } from "./link/control";
import { Entering } from "./link/entering";
import { Link } from "./link/link";
import { moveObject } from "./link/messages";
import { Motions } from "./link/motions";
import { Orders } from "./link/orders";
import { showPlans } from "./link/shown-plans";
import { Stopping } from "./link/stopping";
import { checkTargets } from "./link/target-check";
import { hearController, hearTopics, startAnew } from "./link/topics";
import { serverUrl } from "./logic/address";
import { panel } from "./panel/panel";
import { emptyState } from "./state/state";
import { Store } from "./state/store";
import { heldToken, takeTokenOfAddress } from "./state/token";
import type { Moved } from "./view/object-drag";
import { startView } from "./view/view";

/** Start the page: the panel first, so that STOP is there whatever becomes of the rest. */
export function startPage(): void {
  const url = serverUrl(location.href);
  const store = new Store(emptyState(url));
  takeTokenOfAddress();
  const link = new Link(url, (news) => store.patch("link", news), heldToken);
  const entering = new Entering(link, store);
  const motions = new Motions(link, store);
  const orders = new Orders(link, store);
  const stopping = new Stopping(link, store, () => motions.cancel());
  panel({ store, motions, orders, stopping, entering });
  hearTopics(link, store);
  hearControl(link, store);
  checkTargets(link, store);
  showPlans(link, store, motions);
  const known = new Set<string>();
  store.subscribe(
    (state) => state.link.connected,
    (connected) => {
      if (!connected) return;
      startAnew(store);
      hearController(link, store, known).catch(() => undefined);
    },
  );
  link.open();
  const canvas = document.querySelector<HTMLCanvasElement>("#view");
  const moved: Moved = (id, position_m, orientation) => orders.changeScene(moveObject(id, position_m, orientation));
  inspectable(store, canvas && startView(canvas, store, moved));
}
