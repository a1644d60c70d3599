import type { Connection } from "./connection";

const TYPE = "sensor_msgs/msg/CompressedImage";

/** Least time between two pictures of a camera [ms]. */
const PERIOD_MS = 100;

export class Cameras {
  constructor(private readonly connection: Connection) {}

  async topics(): Promise<string[]> {
    const { topics } = await this.connection.call<{ topics: string[] }>("/rosapi/topics_for_type", { type: TYPE });
    return topics;
  }

  watch(topic: string, show: (url: string) => void): () => void {
    return this.connection.subscribe(topic, TYPE, ({ format, data }) => show(pictureUrl(format, data)), PERIOD_MS);
  }
}

export function pictureUrl(format: string, data: string): string {
  return `data:image/${/png/i.test(format) ? "png" : "jpeg"};base64,${data}`;
}
