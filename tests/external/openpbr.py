"""Exported OpenPBR documents, next to MaterialX's own library."""

import MaterialX as mx
from MaterialX import PyMaterialXGenShader

SEARCH = mx.getDefaultDataSearchPath()
LIBRARY = mx.createDocument()
mx.loadLibraries(mx.getDefaultDataLibraryFolders(), SEARCH, LIBRARY)


def read(path):
    document = mx.createDocument()
    mx.readFromXmlString(document, path.read_text())
    document.setDataLibrary(LIBRARY)
    return document


def context_of(generator):
    """What a generator of code needs."""
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(SEARCH)
    return context
