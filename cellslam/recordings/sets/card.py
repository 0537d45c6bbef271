"""The card of a set, in the format that data hubs read: Croissant 1.0, JSON-LD.

Source: Croissant Format Specification 1.0 (MLCommons).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from cellslam.scenarios.sets import INDEX, SPLITS, TRUTH, SetDefinition
from cellslam.scenarios.sets.reading import Row

LICENSE = "https://spdx.org/licenses/MIT.html"
FORMAT = "application/x-hdf5"
# What each column of the index holds, and its type in schema.org.
FIELDS = {
    "file": ("path of the recording", "Text"),
    "split": ("train, validation, test, or test-truth", "Text"),
    "trial": ("number of the drive in its split", "Integer"),
    "snapshots": ("number of snapshots", "Integer"),
    "measurements": ("number of measured paths", "Integer"),
    "most_paths": ("most measured paths of a snapshot", "Integer"),
    "sha256": ("digest of the file", "Text"),
    "bound_rmse_m": ("Cramér-Rao bound of the position's RMSE, m; of validation and test-truth", "Float"),
}
_CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/", "citeAs": "cr:citeAs", "column": "cr:column",
    "conformsTo": "dct:conformsTo", "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"}, "equivalentProperty": "cr:equivalentProperty",
    "samplingRate": "cr:samplingRate", "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract", "field": "cr:field",
    "fileObject": "cr:fileObject", "fileProperty": "cr:fileProperty", "fileSet": "cr:fileSet", "format": "cr:format",
    "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset", "jsonPath": "cr:jsonPath", "key": "cr:key",
    "md5": "cr:md5", "parentField": "cr:parentField", "path": "cr:path", "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "sc": "https://schema.org/", "separator": "cr:separator", "source": "cr:source",
    "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip


def card(one: SetDefinition, index: bytes, rows: Sequence[Row], size: int, versions: Mapping[str, str]) -> bytes:
    """Return the card of a set: what it is, how it was made, by which versions, how large, under which licence.

    `index`: the bytes of its index, whose rows are `rows`; `size`: of all files in bytes.
    """
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    truths = "\n".join(row.sha256 for row in rows if row.split == TRUTH)
    counts = ", ".join(f"{one.drives[split]} drives of {split}" for split in SPLITS)
    description = (
        f"{one.title[0].upper()}{one.title[1:]}: what a vehicle measures of cellular multipath (delay and angles of "
        f"each path), its odometry, and the truth. {counts}; scenario {one.preset} of cellslam, root seeds "
        f"{', '.join(f'{seed} ({split})' for split, seed in one.seeds.items())}. Made by 'cellslam dataset make "
        f"{one.name}' with {made}. The drives of the split test have no truth: {TRUTH} has it, and the SHA-256 of its "
        f"digests, a line each, is {hashlib.sha256(truths.encode()).hexdigest()}."
    )
    card = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": one.name,
        "description": description,
        "citeAs": f"The cellslam developers: {one.name}, a set of simulated drives, made with cellslam.",
        "creator": {"@type": "sc:Organization", "name": "The cellslam developers"},
        "datePublished": one.published,
        "keywords": ["SLAM", "multipath", "positioning", "simulation"],
        "license": LICENSE,
        "version": f"1.0.0+{one.digest[:12]}",
        "contentSize": f"{size} B",
        "distribution": [
            {
                "@type": "cr:FileObject", "@id": INDEX, "name": INDEX, "contentUrl": INDEX,
                "encodingFormat": "text/csv", "contentSize": f"{len(index)} B",
                "sha256": hashlib.sha256(index).hexdigest(),
            },
            *({
                "@type": "cr:FileSet", "@id": f"{split}-files", "name": f"{split}-files", "encodingFormat": FORMAT,
                "includes": f"{split}/*.h5",
            } for split in (*SPLITS, TRUTH)),
        ],
        "recordSet": [{
            "@type": "cr:RecordSet", "@id": "drives", "name": "drives", "description": "A row a drive.",
            "field": [{
                "@type": "cr:Field", "@id": f"drives/{name}", "name": name, "description": meaning,
                "dataType": f"sc:{kind}",
                "source": {"fileObject": {"@id": INDEX}, "extract": {"column": name}},
            } for name, (meaning, kind) in FIELDS.items()],
        }],
    }  # fmt: skip
    return json.dumps(card, indent=1).encode()
