import type { ServoHistory } from "../logic/servo-history";
import type { Connection } from "./connection";
import { readNumbers, type ServoHistoryResponse } from "./messages";

/** Ask the server for the last minutes of a joint's servo; null where it has none, or cannot be asked. */
export async function fetchServoHistory(connection: Connection, joint: string): Promise<ServoHistory | null> {
  try {
    const response = await connection.call<ServoHistoryResponse>("/arm/servo_history", { joint });
    const { time_s, events } = response;
    if (time_s.length === 0 && events.length === 0) return null;
    return { time_s, events, temperature_c: readNumbers(response.temperature_c), load: readNumbers(response.load) };
  } catch {
    // A server without the service: the lines begin when the page does.
    return null;
  }
}
