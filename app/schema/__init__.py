"""The language of files: YAML with places, sections, quantities with units, expressions."""
