// Decodes CDR with the readers that Foxglove and Lichtblick use. Standard input: JSON, topic -> {definition, base64};
// standard output: JSON, topic -> the message.

import { readFileSync } from "node:fs";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

const asked = JSON.parse(readFileSync(0, "utf8"));

function decode({ definition, base64 }) {
  const reader = new MessageReader(parse(definition, { ros2: true }));
  return reader.readMessage(Buffer.from(base64, "base64"));
}

function plain(_, value) {
  if (typeof value === "bigint") {
    return Number(value);
  }
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

const decoded = Object.fromEntries(Object.entries(asked).map(([topic, message]) => [topic, decode(message)]));
console.log(JSON.stringify(decoded, plain));
