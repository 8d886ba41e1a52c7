"""What a solved scene writes: fields, tables, pictures, the record and the report."""
