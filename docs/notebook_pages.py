"""
A hook of MkDocs: every notebook of `docs/` becomes a page, with its outputs, and links to notebooks lead to the pages.
"""

from __future__ import annotations

import json
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


def markdown(text: str) -> str:
    """The cells of a notebook as Markdown."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f'<img alt="output of the code above" src="data:image/png;base64,{data["image/png"]}">')
            else:
                parts.append("```text\n" + "".join(output.get("text", data.get("text/plain", []))).rstrip() + "\n```")
    return "\n\n".join(parts)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Pages from notebooks; the notebooks stay there, to be downloaded."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        page = markdown(file.content_string) + f"\n\n[This page as a notebook]({file.src_uri.rsplit('/', 1)[-1]})\n"
        files.append(File.generated(config, file.src_uri.removesuffix(".ipynb") + ".md", content=page))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links that work among the files of a repository, among the pages of the site."""
    return re.sub(r"(?<!as a notebook)\]\(([\w/]+)\.ipynb\)", r"](\1.md)", markdown)
