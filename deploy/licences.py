"""Prints the licence of every crate that is linked into the program, with the texts that came along. Ends with an error when
one has a licence that is not among those agreed to."""

import json
import pathlib
import subprocess
import sys

# What may be in the program: permissive licences, and the weak ones of single parts.
AGREED = {
    "0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-1-Clause", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0",
    "CC0-1.0", "CDLA-Permissive-2.0", "EPL-2.0", "IJG", "ISC", "MIT", "MIT-0", "MPL-2.0", "OpenSSL", "Unicode-3.0",
    "Unicode-DFS-2016", "Unlicense", "Zlib",
}


def choices(expression: str) -> list[set[str]]:
    """The alternatives of an SPDX expression, each as the set of licences that it asks for."""
    words = expression.replace("/", " OR ").replace("(", " ( ").replace(")", " ) ").split()
    place = 0

    def atom() -> list[set[str]]:
        nonlocal place
        if words[place] == "(":
            place += 1
            inside = either()
            place += 1
            return inside
        name = words[place]
        place += 1
        if place < len(words) and words[place] == "WITH":
            name += " WITH " + words[place + 1]
            place += 2
        return [{name}]

    def both() -> list[set[str]]:
        nonlocal place
        left = atom()
        while place < len(words) and words[place] == "AND":
            place += 1
            right = atom()
            left = [a | b for a in left for b in right]
        return left

    def either() -> list[set[str]]:
        nonlocal place
        left = both()
        while place < len(words) and words[place] == "OR":
            place += 1
            left = left + both()
        return left

    return either()


def linked(metadata: dict) -> set[str]:
    """Ids of what the program links: its dependencies, and theirs, without those of tests and builds."""
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    todo, seen = [metadata["resolve"]["root"]], set()
    while todo:
        one = todo.pop()
        if one in seen:
            continue
        seen.add(one)
        for dependency in nodes[one]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                todo.append(dependency["pkg"])
    return seen


def main() -> int:
    metadata = json.loads(
        subprocess.check_output(
            ["cargo", "metadata", "--format-version=1", "--locked", "--features=turbojpeg",
             "--filter-platform=x86_64-unknown-linux-gnu"]
        )
    )
    wanted, refused, texts = linked(metadata), [], {}
    for package in sorted(metadata["packages"], key=lambda package: (package["name"], package["version"])):
        if package["id"] not in wanted or package["source"] is None:
            continue
        name = f"{package['name']} {package['version']}"
        expression = package["license"] or "see its licence file"
        print(f"{name}: {expression}" + (f" ({package['repository']})" if package["repository"] else ""))
        if package["license"] and not any(choice <= AGREED for choice in choices(package["license"])):
            refused.append(f"{name}: {expression}")
        folder = pathlib.Path(package["manifest_path"]).parent
        for file in sorted(folder.iterdir()):
            if file.is_file() and file.name.upper().startswith(("LICENSE", "LICENCE", "COPYING", "NOTICE", "COPYRIGHT")):
                text = file.read_text(errors="replace").strip()
                texts.setdefault(text, []).append(f"{name} ({file.name})")
    for text, names in texts.items():
        print("\n" + "=" * 78)
        print("\n".join(names))
        print("-" * 78)
        print(text)
    for one in refused:
        print(f"not agreed to: {one}", file=sys.stderr)
    return 1 if refused else 0


sys.exit(main())
