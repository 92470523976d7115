from matplotlib.figure import Figure
from multicontact_control.experiment.study.page import Page, Section, write_study_page
from multicontact_control.experiment.study.table import Column, Line, Listing


def test_page_has_what_came_out_before_figure_and_tables(tmp_path):
    listing = Listing([Column('x')], [Line(['cell <1>'])])
    page = Page('A <study>', [Section('Plant <p>', listing, before='<i>b</i>', after='<u>a</u>')],
                introduction=['Why & how', ''], warnings=['bad <w>'], findings=['good <f>'],
                figure=Figure(), script='run()')
    png, html = write_study_page(page, tmp_path / 'study')
    assert (png.name, html.name) == ('study.png', 'study.html')
    text = html.read_text()
    found = [text.index(part) for part in (
        '<h1>A &lt;study&gt;', 'Why &amp; how', 'bad &lt;w&gt;', 'good &lt;f&gt;', '<img',
        'Plant &lt;p&gt;', '<i>b</i>', 'cell &lt;1&gt;', '<u>a</u>', '<script>run()</script>')]
    assert found == sorted(found)
    assert text.count('<p>') == 1


def test_page_without_figure_is_one_file(tmp_path):
    paths = write_study_page(Page('Plain', []), tmp_path / 'study')
    assert list(tmp_path.iterdir()) == paths
    assert '<img' not in paths[0].read_text() and 'What came out' not in paths[0].read_text()
