"""What every file has in common: text, YAML, schemas, and outputs that appear complete."""
