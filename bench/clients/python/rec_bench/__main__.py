"""`python -m rec_bench layout`: the sample's layout as JSON."""

import json
import sys

from .sample import layout

if sys.argv[1:] != ["layout"]:
    sys.exit("usage: python -m rec_bench layout")
print(json.dumps(layout()))
