use std::sync::Arc;

use super::*;
use crate::brdf::{Atom, Dictionary, Mixture};
use crate::cells::CellOptions;
use crate::cells::tests::bowl;
use crate::transport::{CacheOptions, Proposal, RenderOptions, render};

/// What a fit models of a cell is the mean of its pixels' renders, through a lens that distorts
/// and blurs, also where pixels of the cell are missing: χ² of the differences over their
/// variances, 50 cells of each size at most, stays within four deviations of its mean.
#[test]
fn a_cells_model_is_the_mean_of_its_pixels() {
    let scene = bowl([96, 72]);
    let atoms = vec![
        Atom::Lambertian { albedo: 1.0 },
        Atom::Ggx {
            alpha: 0.2,
            eta: 1.8,
        },
    ];
    let dictionary = Arc::new(Dictionary::new("two", atoms).unwrap());
    let weights = vec![0.6, 0.4];
    let material = Mixture::grey(dictionary.clone(), weights.clone()).unwrap();
    let options = RenderOptions {
        samples_per_pixel: 256,
        max_reflections: 4,
        seed: 8,
        proposal: Proposal::resembling(&material, 0.2),
        ..RenderOptions::default()
    };
    let mut images = render(&scene, &material, &options);
    // Every seventh pixel of one image says nothing.
    for pixel in (0..images[1].valid.len()).step_by(7) {
        images[1].valid[pixel] = false;
    }
    let captured = Captured::new(&scene, &images, &CellOptions::exact()).unwrap();
    let cache = CacheOptions {
        samples_per_cell: 1024,
        max_reflections: 4,
        proposal: options.proposal.clone(),
        ..CacheOptions::default()
    };
    let cells = &captured.cells;
    let cache = Cache::trace(&scene, cells, &dictionary, &cache).unwrap();
    let direct = DirectMatrix::new(&scene, cells, &dictionary, 32, 5);
    let objective = Objective::new(
        &cache,
        &direct,
        &captured,
        Channels::Shared,
        Kernel::detect(),
        0.0,
    );
    let model = objective.modelled(&[nalgebra::DVector::from_vec(weights)]);
    let (mut chi2, mut count, mut partial) = (0.0, 0.0, 0);
    for (light, cell) in (0..2).flat_map(|light| (0..cells.len()).map(move |cell| (light, cell))) {
        if !objective.is_compared(light, cell) {
            continue;
        }
        let [rendered, variance] = objective.captured(light, cell);
        let modelled = model[light][cell][1];
        // The direct quadrature's own error is a thousandth.
        let quadrature = 1e-3 * modelled.value();
        let spread = variance[1] + modelled.variance + quadrature * quadrature;
        chi2 += (rendered[1] - modelled.value()).powi(2) / spread;
        count += 1.0;
        let whole = (cells.cell(cell).side_px as usize).pow(2);
        partial += usize::from(cells.cell(cell).pixels() < whole);
    }
    println!(
        "{count} cells, {partial} in part: chi2/n {:.3}",
        chi2 / count
    );
    assert!(count > 500.0 && partial > 100, "{count} {partial}");
    let deviations = (chi2 - count) / (2.0 * count).sqrt();
    // Variances of few paths are themselves known within some percent.
    assert!(
        deviations.abs() < 4.0 + 0.1 * count / (2.0 * count).sqrt(),
        "{deviations}"
    );
}
