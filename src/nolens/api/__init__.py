"""The functions of `import nolens as nl`: arrays in, pictures out, no files needed.

`nolens/__init__.pyi` lists them all.
"""
