// Listens to a server as a client of Foxglove does, by its own library, until each topic has had a message, and prints
// these as JSON: node listen.mjs URL SUBPROTOCOL TOPIC...
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

import { READERS } from "./readers.mjs";

const [url, subprotocol, ...wanted] = process.argv.slice(2);
const socket = new WebSocket(url, subprotocol);
const client = new protocol.FoxgloveClient({ ws: socket });
const found = { topics: {} };
const subscribed = new Map();
const complete = () => wanted.every((one) => one in found.topics);

client.on("error", (error) => {
  console.error(error.message);
  process.exitCode = 1;
});
client.on("serverInfo", ({ name, capabilities }) => Object.assign(found, { name, capabilities }));
client.on("advertise", (channels) => {
  for (const { id, topic, encoding, schema, schemaName, schemaEncoding } of channels) {
    if (wanted.includes(topic)) {
      const data = schemaEncoding === "protobuf" ? Buffer.from(schema, "base64") : Buffer.from(schema);
      subscribed.set(client.subscribe(id), { topic, schemaName, read: READERS[encoding]({ name: schemaName, data }) });
    }
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  if (complete()) return; // what had arrived with the last that was wanted is still told after the end
  const { topic, schemaName, read } = subscribed.get(subscriptionId);
  const content = read(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
  found.topics[topic] ??= { schema: schemaName, logTime: String(timestamp), content };
  if (complete()) {
    console.log(JSON.stringify(found, (_, value) => (ArrayBuffer.isView(value) ? [...value] : value)));
    socket.terminate(); // nothing that is on its way is waited for
  }
});
