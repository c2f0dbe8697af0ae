"""A real Chromium before a real server with real worker processes: what a person sees, and what it says of the truth.

The steps of the main job are fixtures of the package, each taken once and through the pages, so that every file here
looks at the same installation as its people left it. With `--full`, screenshots are left in `artefacts/screenshots`.
"""
