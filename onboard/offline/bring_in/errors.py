"""Every error that bringing in foreign recordings raises on purpose."""


class ImportFileError(ValueError):
    """Base of them all. The message is a sentence that names the file and ends with the remedy."""


class MappingError(ImportFileError):
    """The mapping file cannot be used."""


class SourceError(ImportFileError):
    """A recording is not what the mapping says it is."""
