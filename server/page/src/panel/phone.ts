import qrcode from "qrcode-generator";
import "./phone.css";
import type { PhoneAccess } from "../link/phone";
import { modulePath, phoneAddress, phoneUrls } from "../logic/phone-address";
import { t } from "../texts/texts";
import { permissionFieldset, type PanelContext } from "./context";
import { button, el, option, section, setText, svg } from "./dom";
import { phoneController } from "./phone-controller";

/** Light modules around a code, without which cameras do not find it (ISO/IEC 18004, section 5.3.8). */
const QUIET_ZONE = 4;

/** Create the section with which a phone becomes a controller: the code to scan, and the controls on the phone itself. */
export function phoneSection(context: PanelContext): HTMLElement {
  const is_phone = matchMedia("(pointer: coarse)").matches;
  const controller = phoneController(context);
  const code = codeOf(context);
  // On the phone its controls come first, elsewhere the code that brings the page onto the phone.
  const parts = is_phone ? [controller, code] : [code, controller];
  return section("phone", t("phone"), is_phone, ...parts);
}

/** Create the button that shows the code, and the place for it. */
function codeOf(context: PanelContext): HTMLElement {
  const place = el("div", { class: "phone-code", testid: "phone-code" });
  const note = el("p", { class: "hint", testid: "phone-note", role: "status" });
  let timer: ReturnType<typeof setTimeout> | undefined;
  const clear = (): void => {
    clearTimeout(timer);
    place.replaceChildren();
  };
  const showCode = async (): Promise<void> => {
    clear();
    try {
      const access = await context.phoneAccess();
      const urls = phoneUrls(location.href, access.urls);
      setText(note, noteOf(access, urls));
      const url = urls[0];
      if (!access.success || url === undefined) return;
      place.replaceChildren(...addressOf(urls, access.token));
      if (access.token === "") return;
      // A code that no longer opens anything would only be scanned in vain.
      timer = setTimeout(() => {
        clear();
        setText(note, t("phone.expired"));
      }, access.expires_in_s * 1000);
    } catch (error) {
      setText(note, (error as Error).message);
    }
  };
  const show = button(t("phone.show_code"), "phone-show-code", () => void showCode());
  return el("div", { class: "rows" }, permissionFieldset(context, "configure", show), note, place);
}

/** Return what a user has to know about the code: what it opens, or what is missing. */
function noteOf({ success, message, token, expires_in_s, encrypted }: PhoneAccess, urls: readonly string[]): string {
  if (!success) return message;
  if (urls.length === 0) return t("phone.this_machine_only");
  const is_encrypted = urls[0]?.startsWith("https:") ?? encrypted;
  const opens = token === "" ? t("phone.no_token") : t("phone.one_time", { seconds: expires_in_s });
  return is_encrypted ? opens : `${opens} ${t("phone.not_encrypted")}`;
}

/** Create the code and the text of an address, with a choice where the server has several. */
function addressOf(urls: readonly string[], token: string): HTMLElement[] {
  const place = el("div", { class: "qr" });
  const text = el("code", { testid: "phone-address" });
  const show = (url: string): void => {
    const address = phoneAddress(url, token);
    place.replaceChildren(qrCode(address));
    setText(text, address);
  };
  show(urls[0] ?? "");
  if (urls.length < 2) return [place, text];
  const choice = el("select", { testid: "phone-url", label: t("phone.address") });
  choice.append(...urls.map((url) => option(url, url)));
  choice.addEventListener("change", () => show(choice.value));
  return [el("label", { class: "line" }, `${t("phone.address")} `, choice), place, text];
}

/** Draw a QR code. */
function qrCode(text: string): SVGElement {
  const code = qrcode(0, "M");
  code.addData(text);
  code.make();
  const count = code.getModuleCount();
  const side = count + 2 * QUIET_ZONE;
  const path = svg("path", { d: modulePath(count, (row, column) => code.isDark(row, column)) });
  const viewBox = `${-QUIET_ZONE} ${-QUIET_ZONE} ${side} ${side}`;
  return svg("svg", { viewBox, role: "img", "aria-label": t("phone.code"), "data-testid": "phone-qr" }, path);
}
