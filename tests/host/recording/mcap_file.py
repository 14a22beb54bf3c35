"""An MCAP file as the reader of the package ``mcap`` gives it, which shares no code with its writer."""

import json
from collections import defaultdict
from pathlib import Path

import jsonschema
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2


def topics(path):
    """Return the messages of each topic, in the order in which they were written."""
    found = defaultdict(list)
    with Path(path).open("rb") as file:
        for _, channel, message in SeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False):
            found[channel.topic].append(message)
    return dict(found)


def decoded(path):
    """Return each message decoded by its schema, as (topic, log time, message)."""
    with Path(path).open("rb") as file:
        reader = SeekingReader(file, decoder_factories=[Protobuf(), Ros2(), Json()])
        return [
            (channel.topic, message.log_time, content)
            for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False)
        ]


class Json:
    """Decodes messages in JSON, and checks them by their schema."""

    def decoder_for(self, encoding, schema):
        if encoding != "json":
            return None
        rules = json.loads(schema.data)
        jsonschema.Draft202012Validator.check_schema(rules)

        def decode(data):
            content = json.loads(data)
            jsonschema.validate(content, rules)
            return content

        return decode
