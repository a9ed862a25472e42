"""Follows one run with the client and prints every field of every sample as a line of JSON: a double by its bits."""

import json
import struct
import sys

from rec_bench import RecBenchSample, Subscriber


def said(value):
    if isinstance(value, float):
        return f"{struct.unpack('<Q', struct.pack('<d', value))[0]:016x}"
    return value


with Subscriber(sys.argv[1]) as subscriber:
    print("ready", flush=True)
    lines = []
    for sample in subscriber.run(timeout_s=120):
        lines.append({name: said(value) for name, value in sample.as_dict().items()})
    for line in lines:
        print(json.dumps(line))
    end = {
        "received": subscriber.received,
        "gaps": subscriber.gaps,
        "joined_at": subscriber.joined_at,
        "certificate": subscriber.certificate(),
        "fields": [name for name, _ in RecBenchSample._fields_],
    }
    print(json.dumps(end))
