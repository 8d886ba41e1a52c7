"""The output of a solved scene: fields, tables, pictures, the record and the report."""
