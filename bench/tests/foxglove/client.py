"""A WebSocket client that knows nothing of the bench: it subscribes to what is advertised, decodes messages by the schema that it is sent,
and prints them as JSON lines, a double by its bits. Ends with the run's last sample."""

import asyncio
import base64
import json
import struct
import sys

import websockets
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FieldDescriptor

SUBSCRIPTION = 77


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
        fields[field.name] = list(value) if hasattr(value, "append") else value_of(field, value)
    return fields


def kind_of(channel):
    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


async def follow(address):
    kind, lines, statuses = None, [], []
    async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        async for message in socket:
            if isinstance(message, str):
                said = json.loads(message)
                if said["op"] == "serverInfo":
                    print(json.dumps(said), flush=True)
                elif said["op"] == "advertise":
                    (channel,) = said["channels"]
                    kind = kind_of(channel)
                    wish = {"op": "subscribe", "subscriptions": [{"id": SUBSCRIPTION, "channelId": channel["id"]}]}
                    await socket.send(json.dumps(wish))
                    # An order that the server must refuse: it takes none.
                    order = {"op": "advertise", "channels": [{"id": 1, "topic": "/stop", "encoding": "json", "schemaName": ""}]}
                    await socket.send(json.dumps(order))
                    print(json.dumps({key: channel[key] for key in ("topic", "encoding", "schemaName", "schemaEncoding")}), flush=True)
                elif said["op"] == "status":
                    statuses.append(said)
                    if "ended" in said["message"]:
                        break
                continue
            code, subscription, log_time = struct.unpack_from("<BIQ", message)
            assert (code, subscription) == (1, SUBSCRIPTION), (code, subscription)
            decoded = kind.FromString(message[13:])
            lines.append({"log_time": log_time, "fields": fields_of(decoded)})
    for line in lines:
        print(json.dumps(line))
    print(json.dumps(statuses))


asyncio.run(asyncio.wait_for(follow(sys.argv[1]), 180))
