import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { modulePath, phoneAddress, phoneUrls } from "../logic/phone-address";
import { t } from "../texts/texts";
import { Button, Gate, Line, Select, usePage } from "./ui";

/** Light modules around a code, without which cameras do not find it (ISO/IEC 18004, section 5.3.8). */
const QUIET_ZONE = 4;

/** Address of the page for another device, as the server tells it. */
interface PhoneAccess {
  success: boolean;
  message: string;
  /** Lets one connection in; empty where no token is needed, or none was issued. */
  token: string;
  expires_in_s: number;
  encrypted: boolean;
  urls: string[];
}

export function AccessCode({ name, role, text }: { name: "phone" | "share"; role: string; text: string }): JSX.Element {
  const { connection } = usePage();
  const [note, setNote] = useState("");
  const [shown, setShown] = useState<{ urls: string[]; access: PhoneAccess } | null>(null);
  const show = async (): Promise<void> => {
    setShown(null);
    try {
      const access = await connection.call<PhoneAccess>("/armbridge/issue_one_time_token", { role });
      const urls = phoneUrls(location.href, access.urls);
      setNote(noteOf(access, urls));
      if (access.success && urls.length > 0) setShown({ urls, access });
    } catch (error) {
      setNote((error as Error).message);
    }
  };
  useEffect(() => {
    if (shown === null || shown.access.token === "") return;
    // A code that no longer opens anything would only be scanned in vain.
    const timer = setTimeout(() => {
      setShown(null);
      setNote(t("phone.expired"));
    }, shown.access.expires_in_s * 1000);
    return () => clearTimeout(timer);
  }, [shown]);
  return (
    <div class="rows">
      <Gate to="configure"><Button testid={`${name}-show-code`} press={() => void show()}>{text}</Button></Gate>
      <p class="hint" data-testid={`${name}-note`} role="status">{note}</p>
      <div class="phone-code" data-testid={`${name}-code`}>{shown && <Address name={name} urls={shown.urls} token={shown.access.token} />}</div>
    </div>
  );
}

function noteOf({ success, message, token, expires_in_s, encrypted }: PhoneAccess, urls: readonly string[]): string {
  if (!success) return message;
  if (urls.length === 0) return t("phone.this_machine_only");
  const is_encrypted = urls[0]?.startsWith("https:") ?? encrypted;
  const opens = token === "" ? t("phone.no_token") : t("phone.one_time", { seconds: expires_in_s });
  return is_encrypted ? opens : `${opens} ${t("phone.not_encrypted")}`;
}

function Address({ name, urls, token }: { name: string; urls: readonly string[]; token: string }): JSX.Element | null {
  const [url, choose] = useState(urls[0] ?? "");
  const [code, setCode] = useState({ path: "", count: 0 });
  const address = phoneAddress(url, token);
  useEffect(() => {
    void import("qrcode-generator").then(({ default: qrcode }) => {
      const drawn = qrcode(0, "M");
      drawn.addData(address);
      drawn.make();
      const count = drawn.getModuleCount();
      setCode({ count, path: modulePath(count, (row, column) => drawn.isDark(row, column)) });
    });
  }, [address]);
  if (code.count === 0) return null;
  const side = code.count + 2 * QUIET_ZONE;
  return (
    <>
      {urls.length > 1 && <Line text={t("phone.address")}><Select testid={`${name}-url`} label={t("phone.address")} value={url} options={urls.map((each) => [each, each])} take={choose} /></Line>}
      <div class="qr">
        <svg viewBox={`${-QUIET_ZONE} ${-QUIET_ZONE} ${side} ${side}`} role="img" aria-label={t("phone.code")} data-testid={`${name}-qr`}><path d={code.path} /></svg>
      </div>
      <code data-testid={`${name}-address`}>{address}</code>
    </>
  );
}
