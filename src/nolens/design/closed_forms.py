"""The closed forms of the paper's eq. 3 and 5, beside the matrices that they follow from."""

from nolens.optics import Number


def master_radius_um(
    film_um: Number,
    film_index: Number,
    distance_um: Number,
    glass_um: Number,
    glass_index: Number,
    gap_um: Number,
) -> Number:
    r"""Radius of curvature of a master film from where it is sharpest, exactly.

    With :math:`n_0 = 1` eq. 1 gives :math:`N_{11} = 0` at

    .. math:: R = \frac{n_p - 1}{n_p}\Bigl[t_p + \frac{n_p}{n_g} t_g + n_p (d_g + d_p)\Bigr].

    Parameters
    ----------
    film_um, film_index
        Thickness :math:`t_p` and index :math:`n_p` of the film, whose relief faces the scene.
    distance_um
        :math:`d_p`, from the film to the cover glass.
    glass_um, glass_index
        Of the cover glass, :math:`t_g` and :math:`n_g`.
    gap_um
        :math:`d_g`, from the glass to the sensor.
    """
    glass = film_index / glass_index * glass_um
    air = film_index * (gap_um + distance_um)
    return (film_index - 1) / film_index * (film_um + glass + air)


def printed_radius_um(
    film_um: Number, film_index: Number, distance_um: Number, glass_um: Number, gap_um: Number
) -> Number:
    r"""Radius of curvature by eq. 3 as it is printed (`uvimprint`): the glass lacks its factor.

    :math:`R = \frac{n_p - 1}{n_p}[t_p + t_g + n_p (d_g + d_p)]`; see `master_radius_um`, which is
    right.
    """
    air = film_index * (gap_um + distance_um)
    return (film_index - 1) / film_index * (film_um + glass_um + air)


def replica_thickness_um(
    radius_um: Number, index: Number, glass_um: Number, glass_index: Number, gap_um: Number
) -> Number:
    r"""Thickness of a replica on the cover glass (`uvimprint`, eq. 5).

    .. math:: t' = n' \Bigl[\frac{R}{n' - 1} - \frac{t_g}{n_g} - d_g\Bigr]

    Parameters
    ----------
    radius_um
        R, of its lenslets, which face the scene.
    index
        :math:`n'`, of the replica.
    glass_um, glass_index, gap_um
        As for `master_radius_um`.
    """
    return index * (radius_um / (index - 1) - glass_um / glass_index - gap_um)
