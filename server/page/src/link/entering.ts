import type { State } from "../state/state";
import type { Store } from "../state/store";
import { heldToken, keepToken, takeTokenOfAddress } from "../state/token";
import type { Link } from "./link";

/** Shows the server the token that the user has given. */
export class Entering {
  /**
   * @param link - connects anew with each token.
   * @param store - told whether there is one, and whether the user is asked for one.
   */
  constructor(
    private readonly link: Link,
    private readonly store: Store<State>,
  ) {
    this.tell();
    store.subscribe(
      (state) => state.link.refused,
      (refused) => refused && this.ask(),
    );
    // An address with another token, put into a tab that has the page already, loads nothing.
    window.addEventListener("hashchange", () => takeTokenOfAddress() && this.anew());
  }

  /** Ask the user for a token. */
  ask(): void {
    this.store.patch("token", { asked: true });
  }

  /** Connect with this token; null for none. */
  enter(token: string | null): void {
    keepToken(token);
    this.anew();
  }

  private anew(): void {
    this.tell();
    this.link.reopen();
  }

  private tell(): void {
    this.store.set({ token: { held: heldToken() !== null, asked: false } });
  }
}
