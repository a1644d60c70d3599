import { t } from "../texts/texts";

declare const __VERSION__: string | undefined;

export const PAGE_VERSION = typeof __VERSION__ === "string" ? __VERSION__ : "";

/** Return the sentence about a server of another version than the page's; empty for the same, or where one is unknown. */
export function versionMismatch(server: string, page: string): string {
  return server === "" || page === "" || server === page ? "" : t("version.mismatch", { server, page });
}
