"""Reads a recording with the packages mcap and mcap-protobuf-support, which know nothing of this project, and prints it as JSON.

Lines: what each metadata record says, then every message by its index (make_reader), then every message as it stands in the file with
all checksums checked (NonSeekingReader). A double is given by its bits, so that nothing is lost on the way.
"""

import json
import struct
import sys

from google.protobuf.descriptor import FieldDescriptor
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory


def value_of(field, value):
    if field.type == FieldDescriptor.TYPE_DOUBLE:
        return f"{struct.unpack('<Q', struct.pack('<d', value))[0]:016x}"
    return value


def fields_of(message):
    fields = {}
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not message.HasField(field.name):
            continue
        value = getattr(message, field.name)
        repeated = isinstance(value, (list, tuple)) or hasattr(value, "append")
        fields[field.name] = [value_of(field, one) for one in value] if repeated else value_of(field, value)
    return fields


def say(**line):
    print(json.dumps(line))


def messages(reader, way, by_time):
    for schema, channel, message, decoded in reader.iter_decoded_messages(log_time_order=by_time):
        say(
            way=way,
            topic=channel.topic,
            encoding=channel.message_encoding,
            schema=schema.name,
            sequence=message.sequence,
            log_time=message.log_time,
            publish_time=message.publish_time,
            fields=fields_of(decoded),
        )


path = sys.argv[1]
with open(path, "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    header = reader.get_header()
    say(way="header", profile=header.profile, library=header.library)
    for metadata in reader.iter_metadata():
        say(way="metadata", name=metadata.name, fields=metadata.metadata)
    summary = reader.get_summary()
    counts = {str(channel): count for channel, count in summary.statistics.channel_message_counts.items()}
    packing = sorted({chunk.compression for chunk in summary.chunk_indexes})
    say(way="summary", counts=counts, packing=packing)
    messages(reader, "index", by_time=True)
with open(path, "rb") as file:
    reader = NonSeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    messages(reader, "stream", by_time=False)
