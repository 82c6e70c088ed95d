"""A page on this machine for looking and trying: `nnpp-edge view`.

The page (`page/`) holds the question (`asked`) and sends it whole: the server remembers nothing of
a tab. `landscape` plans, `answers` makes of it what the page draws; `server` alone knows of HTTP.
"""
