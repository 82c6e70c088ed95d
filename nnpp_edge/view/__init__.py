"""A page on this machine for looking and trying: `nnpp-edge view`.

What is shown and asked (`site`, `asked`, `landscape`, `trial`, `mending`, `words`) is plain Python. `layers` and
`answers` make of it what the page draws; `server` alone knows of HTTP. The page itself stands in `page/`.
"""
