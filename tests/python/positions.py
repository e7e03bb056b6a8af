"""Reads the GeoJSON of a hub as GDAL does, and prints what it found as JSON.

    python positions.py positions.geojson
"""

import json
import struct
import sys

from pyogrio import raw


def coordinates(wkb):
    """The coordinates of a point or of a line in little-endian WKB."""
    order, kind = struct.unpack_from("<BI", wkb)
    assert order == 1 and kind in (1, 2), (order, kind)
    count, start = (1, 5) if kind == 1 else (*struct.unpack_from("<I", wkb, 5), 9)
    return [struct.unpack_from("<dd", wkb, start + 16 * at) for at in range(count)]


meta, _, geometries, columns = raw.read(sys.argv[1])
fields = dict(zip(meta["fields"], columns))
print(json.dumps({
    "crs": meta["crs"],
    "types": dict(zip(meta["fields"], meta["dtypes"])),
    "clips": [
        {
            "node": fields["node"][row],
            "distance_m": float(fields["distance_m"][row]),
            "began": str(fields["began"][row]),
            "coordinates": coordinates(geometry),
        }
        for row, geometry in enumerate(geometries)
    ],
}))
