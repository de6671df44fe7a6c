"""Prints the crates that are compiled into the program, with licences and notices.

third_party.py TREE < METADATA, where TREE is what `cargo tree -e normal --prefix none` and
METADATA what `cargo metadata --format-version 1` print.
"""

import collections
import json
import pathlib
import sys

built = {tuple(line.split()[:2]) for line in open(sys.argv[1])}
texts = collections.defaultdict(list)
missing = []
print("Crates compiled into rig. Each text below follows the crates that it belongs to.")
for package in json.load(sys.stdin)["packages"]:
    if (package["name"], "v" + package["version"]) not in built or package["source"] is None:
        continue
    name = f'{package["name"]} {package["version"]} ({package["license"]}) {package["repository"] or ""}'
    folder = pathlib.Path(package["manifest_path"]).parent
    files = [
        file
        for file in sorted(folder.iterdir())
        if file.is_file() and file.name.upper().startswith(("LICENSE", "LICENCE", "COPYING", "NOTICE", "UNLICENSE"))
    ]
    for file in files:
        texts[file.read_text(errors="replace").strip()].append(name)
    if not files:
        missing.append(name)
for text, names in sorted(texts.items(), key=lambda item: item[1]):
    print("\n" + "=" * 78, *names, "-" * 78, text, sep="\n")
print("\n" + "=" * 78, "Without a text of their own; the licence is in brackets:", *missing, sep="\n")
