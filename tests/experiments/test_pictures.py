import torch

from mvsam.data.labels import ClassTable
from mvsam.experiments.pictures import ValidationPictures


def test_labels_are_shown_in_the_colours_of_the_run_s_own_classes():
    colors = tuple((index, 2 * index, 255 - index) for index in range(25))
    pictures = ValidationPictures(ClassTable(tuple(map(str, range(25))), colors))
    picture = pictures._label_picture(torch.tensor([[0, 24], [3, 255]]))
    shown = (255 * picture).round().int().permute(1, 2, 0).reshape(4, 3).tolist()
    assert shown == [list(colors[0]), list(colors[24]), list(colors[3]), [0, 0, 0]]
