// How Foxglove reads a message: by its encoding and its schema.
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { protobufFromBinaryDescriptor } from "@mcap/support";

export const READERS = {
  json: () => (data) => JSON.parse(new TextDecoder().decode(data)),
  protobuf: (schema) => {
    const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
    return (data) => type.toObject(type.decode(data), { longs: Number, defaults: true });
  },
  cdr: (schema) => {
    const reader = new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true }));
    return (data) => reader.readMessage(data);
  },
};
