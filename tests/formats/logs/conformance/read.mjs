// Prints what is in a log as small.json has it, read by implementations of MCAP and CDR in JavaScript.
//
//     npm install @mcap/core@2.2.2 @foxglove/rosmsg@5.0.5 @foxglove/rosmsg2-serialization@3.1.0 fzstd@0.1.1
//     node read.mjs small.mcap

import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";

import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";

const bytes = readFileSync(process.argv[2]);
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => new Uint8Array(bytes.subarray(Number(offset), Number(offset + size))),
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: { zstd: (packed) => decompress(packed) },
});

function plain(value) {
  if (value instanceof Uint8Array) {
    return { bytes: value.length, sha256: createHash("sha256").update(value).digest("hex") };
  }
  if (Array.isArray(value) || ArrayBuffer.isView(value)) {
    return Array.from(value, plain);
  }
  if (value instanceof Map) {
    return Object.fromEntries(value);
  }
  switch (typeof value) {
    case "bigint":
      return Number(value);
    case "number":
      return Number.isFinite(value) ? value : String(value);
    case "object":
      return Object.fromEntries(Object.entries(value).map(([name, item]) => [name, plain(item)]));
    default:
      return value;
  }
}

const decoders = new Map();
for (const { id, data } of reader.schemasById.values()) {
  const definitions = rosmsg.parse(new TextDecoder().decode(data), { ros2: true });
  decoders.set(id, new serialization.MessageReader(definitions, { timeType: "sec,nanosec" }));
}

const found = { attachments: {}, metadata: {}, messages: [] };
for await (const { name, data } of reader.readAttachments()) {
  found.attachments[name] = plain(data);
}
for await (const { name, metadata } of reader.readMetadata()) {
  found.metadata[name] = plain(metadata);
}
const messages = [];
for await (const message of reader.readMessages()) {
  messages.push(message);
}
messages.sort((a, b) => a.sequence - b.sequence); // the reader sorts by time, the record is in the order of writing
for (const { channelId, logTime, data } of messages) {
  const { topic, schemaId } = reader.channelsById.get(channelId);
  const fields = decoders.get(schemaId).readMessage(data);
  found.messages.push({ topic, type: reader.schemasById.get(schemaId).name, time: Number(logTime), fields: plain(fields) });
}
process.stdout.write(JSON.stringify(found));
