"""Error tree of the import of foreign recordings."""


class ImportFileError(ValueError):
    """Base of all import errors. The message names the file and ends with the remedy."""


class MappingError(ImportFileError):
    """The mapping file cannot be used."""


class SourceError(ImportFileError):
    """A recording does not match the mapping."""
