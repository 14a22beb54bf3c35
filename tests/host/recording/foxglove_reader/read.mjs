// Reads a recording as Foxglove does, by its own libraries, and prints what it finds as JSON: node read.mjs FILE
// Foxglove reads by the index if there is one, and from the begin to the end if there is none.
import { open } from "node:fs/promises";

import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

import { READERS } from "./readers.mjs";

async function* records(file, decompressHandlers, found) {
  let reader;
  try {
    reader = await McapIndexedReader.Initialize({ readable: new FileHandleReadable(file), decompressHandlers });
  } catch (error) {
    found.notIndexed = error.message;
    const stream = new McapStreamReader({ validateCrcs: true, decompressHandlers });
    stream.append(await file.readFile());
    for (let record; (record = stream.nextRecord()) !== undefined; ) {
      yield record;
    }
    found.ended = stream.done();
    return;
  }
  found.counts = Object.fromEntries([...reader.statistics.channelMessageCounts].map(([id, n]) => [id, Number(n)]));
  found.chunks = reader.chunkIndexes.length;
  yield* reader.schemasById.values();
  yield* reader.channelsById.values();
  yield* reader.readMetadata();
  yield* reader.readAttachments();
  yield* reader.readMessages({ validateCrcs: true });
}

const found = { topics: {}, attachments: [], metadata: [] };
const [schemas, channels] = [new Map(), new Map()];
const file = await open(process.argv[2]);
for await (const record of records(file, await loadDecompressHandlers(), found)) {
  if (record.type === "Schema") {
    schemas.set(record.id, record);
  } else if (record.type === "Channel") {
    const schema = schemas.get(record.schemaId);
    const topic = { id: record.id, schema: schema.name, schemaEncoding: schema.encoding, messages: [] };
    found.topics[record.topic] ??= topic;
    channels.set(record.id, { topic: found.topics[record.topic], read: READERS[record.messageEncoding](schema) });
  } else if (record.type === "Message") {
    const { topic, read } = channels.get(record.channelId);
    topic.messages.push({ logTime: String(record.logTime), content: read(record.data) });
  } else if (record.type === "Attachment") {
    found.attachments.push({ name: record.name, text: new TextDecoder().decode(record.data) });
  } else if (record.type === "Metadata") {
    found.metadata.push(record.name);
  }
}
await file.close();
console.log(JSON.stringify(found, (_, value) => (ArrayBuffer.isView(value) ? [...value] : value)));
