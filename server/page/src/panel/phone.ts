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
  const code = accessCode(context, "phone", "", t("phone.show_code"));
  // On the phone its controls come first, elsewhere the code that brings the page onto the phone.
  const parts = is_phone ? [controller, code] : [code, controller];
  return section("phone", t("phone"), is_phone, ...parts);
}

/** Create a button that shows a code with which one device opens the page in a role, and the place for the code. */
export function accessCode(context: PanelContext, name: "phone" | "share", role: string, text: string): HTMLElement {
  const place = el("div", { class: "phone-code", testid: `${name}-code` });
  const note = el("p", { class: "hint", testid: `${name}-note`, role: "status" });
  let timer: ReturnType<typeof setTimeout> | undefined;
  const clear = (): void => {
    clearTimeout(timer);
    place.replaceChildren();
  };
  const showCode = async (): Promise<void> => {
    clear();
    try {
      const access = await context.phoneAccess(role);
      const urls = phoneUrls(location.href, access.urls);
      setText(note, noteOf(access, urls));
      const url = urls[0];
      if (!access.success || url === undefined) return;
      place.replaceChildren(...(await addressOf(name, urls, access.token)));
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
  const show = button(text, `${name}-show-code`, () => void showCode());
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
async function addressOf(name: string, urls: readonly string[], token: string): Promise<HTMLElement[]> {
  const { default: qrcode } = await import("qrcode-generator");
  const place = el("div", { class: "qr" });
  const text = el("code", { testid: `${name}-address` });
  const show = (url: string): void => {
    const address = phoneAddress(url, token);
    const code = qrcode(0, "M");
    code.addData(address);
    code.make();
    place.replaceChildren(qrCode(name, code.getModuleCount(), (row, column) => code.isDark(row, column)));
    setText(text, address);
  };
  show(urls[0] ?? "");
  if (urls.length < 2) return [place, text];
  const choice = el("select", { testid: `${name}-url`, label: t("phone.address") });
  choice.append(...urls.map((url) => option(url, url)));
  choice.addEventListener("change", () => show(choice.value));
  return [el("label", { class: "line" }, `${t("phone.address")} `, choice), place, text];
}

/** Draw a QR code. */
function qrCode(name: string, count: number, isDark: (row: number, column: number) => boolean): SVGElement {
  const side = count + 2 * QUIET_ZONE;
  const viewBox = `${-QUIET_ZONE} ${-QUIET_ZONE} ${side} ${side}`;
  return svg("svg", { viewBox, role: "img", "aria-label": t("phone.code"), "data-testid": `${name}-qr` }, svg("path", { d: modulePath(count, isDark) }));
}
