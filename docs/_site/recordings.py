"""Recordings that play in the page: the rerun viewer is copied into the site, out of the package `rerun-notebook`.

A page of the gallery that has a recording (docs/gallery/NAME.rrd) gets a button; recording.js loads the viewer when
that is pressed. Without the package the picture and the file to download stay.
"""

from __future__ import annotations

import functools
import gzip
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent.parent
MODULE, WASM, PACKED = "widget.js", "re_viewer_bg.wasm", "re_viewer_bg.wasm.packed"
"""The viewer's two files, and the second as the site has it: a quarter of its size, whatever server hands it out."""
_OPEN, _CLOSE = "//!<INLINE-MARKER-OPEN>", "//!<INLINE-MARKER-CLOSE>"
_FETCH = f"""
  const response = await fetch(new URL("./{PACKED}", import.meta.url));
  if (!response.ok) throw new Error(`${{response.url}}: ${{response.status}} ${{response.statusText}}`);
  const unpacked = wrap_fetch_with_progress(response, on_progress).body.pipeThrough(new DecompressionStream("gzip"));
  return new Response(unpacked, {{ headers: {{ "Content-Type": "application/wasm" }} }});
  """
_POLICY = '<meta http-equiv="Content-Security-Policy" content="connect-src \'self\'">'
"""The viewer would ask for the newest release of itself."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the viewer, and the script that starts it."""
    from mkdocs.structure.files import File

    for name, content in viewer().items():
        files.append(File.generated(config, f"viewer/{name}", content=content))
    files.append(File.generated(config, "recording.js", content=(ROOT / "docs/_site/recording.js").read_text()))
    return files


@functools.cache
def viewer() -> dict[str, bytes]:
    """The viewer's files as the site has them, from the installed package, which is not imported; none without it."""
    try:
        folder = Path(str(distribution("rerun-notebook").locate_file("rerun_notebook/static")))
    except PackageNotFoundError:
        return {}
    before, _, rest = (folder / MODULE).read_text().partition(_OPEN)  # its makers mark the lines that fetch the other
    _, closed, after = rest.partition(_CLOSE)
    if not closed:
        raise SystemExit(f"{MODULE} of rerun-notebook: wanted {_OPEN} and {_CLOSE}, got a module without them")
    packed = gzip.compress((folder / WASM).read_bytes(), 6, mtime=0)
    return {MODULE: f"{before}{_FETCH}{after}".encode(), PACKED: packed}


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the button below the picture of an example that has a recording."""
    name = recorded(page.file.src_uri)
    megabytes = sum(map(len, viewer().values())) / 1e6
    return with_player(markdown, name, megabytes) if name else markdown


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Let a page that holds the viewer ask nothing of other hosts."""
    return output.replace("<head>", f"<head>{_POLICY}", 1) if recorded(page.file.src_uri) else output


def recorded(page: str) -> str | None:
    """The example that a page shows, if there is a recording of it."""
    recording = ROOT / "docs" / Path(page).with_suffix(".rrd")
    return recording.stem if recording.exists() else None


def with_player(markdown: str, name: str, megabytes: float) -> str:
    """An example's page with a button that plays its recording, after a viewer of so many MB; of 0, without one."""
    picture = f"![The picture that it makes]({name}.webp)"
    before, found, after = markdown.partition(picture)
    if not found:
        raise SystemExit(f"gallery/{name}.md: wanted {picture} to put the recording beside, got no such line")
    size = (ROOT / f"docs/gallery/{name}.rrd").stat().st_size / 1e6
    file = f"[{name}.rrd]({name}.rrd) ({size:.1f} MB) is the recording."
    if not megabytes:
        return f"{before}{found}\n\n{file}\n{after}"
    player = f"""<div class="recording" data-viewer="../viewer/{MODULE}" data-recording="{name}.rrd" markdown>

{picture}

<button type="button" class="md-button" hidden>Play the recording: loads the viewer, about {megabytes:.0f} MB</button>
<p role="status"></p>
<noscript><p>To play the recording here, allow scripts.</p></noscript>
</div>

{file} The viewer is rerun's, under MIT or Apache 2.0.

<script src="../recording.js" defer></script>
"""
    return before + player + after
