import type { Connection } from "./connection";
import type { CompressedImage } from "./messages";

const TYPE = "sensor_msgs/CompressedImage";

/** Least time between two pictures of a camera [ms]. */
const PERIOD_MS = 100;

/** Topics of compressed pictures, of any client. */
export class Cameras {
  constructor(private readonly connection: Connection) {}

  /** Ask for the topics. */
  async topics(): Promise<string[]> {
    const { topics } = await this.connection.call<{ topics: string[] }>("/rosapi/topics_for_type", { type: TYPE });
    return topics;
  }

  /** Show the pictures of a topic as data URLs; return the function that ends it. */
  watch(topic: string, show: (url: string) => void): () => void {
    const take = ({ format, data }: CompressedImage): void => show(pictureUrl(format, data));
    return this.connection.subscribe<CompressedImage>(topic, TYPE, take, PERIOD_MS);
  }
}

export function pictureUrl(format: string, data: string): string {
  return `data:image/${/png/i.test(format) ? "png" : "jpeg"};base64,${data}`;
}
