"""One class for each thing that physics knows: its keys in YAML and its formula."""
