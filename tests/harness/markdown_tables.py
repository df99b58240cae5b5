"""Tables of Markdown, as the pages have them."""


def rows_of(table):
    """Cells of a Markdown table by row, without the header."""
    lines = [line.strip("|").split("|") for line in table.splitlines()[2:]]
    return [[cell.strip() for cell in line] for line in lines]


def columns_of(table, row=0):
    header = [cell.strip() for cell in table.splitlines()[0].strip("|").split("|")]
    return dict(zip(header, rows_of(table)[row], strict=True))
