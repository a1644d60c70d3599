import type { Connection } from "./connection";

/** Address of the page for another device, as the server tells it. */
export interface PhoneAccess {
  success: boolean;
  message: string;
  /** Lets one connection in; empty where no token is needed, or none was issued. */
  token: string;
  expires_in_s: number;
  /** True for addresses of https. */
  encrypted: boolean;
  urls: string[];
}

/** Ask the server for a token that lets one connection in with a role (empty for the server's default), and for its addresses as other devices see them. */
export async function fetchPhoneAccess(connection: Connection, role: string): Promise<PhoneAccess> {
  return connection.call<PhoneAccess>("/armbridge/issue_one_time_token", { role });
}
