// The order of triangles in a balanced tree of boxes: those of a box are split in the middle of their order along the axis on which they are spread most.

const SAMPLES = 33, TRIMMED = 4; // that tell how wide most of them are spread, without the few far ones of a ground

// Numbers of the triangles, in which each box of the tree has a run of its own; leaves: how many boxes of `leaf` triangles there are, a power of 2.
// middles: x, y and z of each triangle.
export function treeOrder(middles, leaves, leaf) {
  const order = Uint32Array.from({ length: middles.length / 3 }, (_, k) => k);
  split(order, middles, 0, leaves, leaf);
  return order;
}

function split(order, middles, first, leaves, leaf) {
  const end = Math.min(first + leaves * leaf, order.length);
  if (leaves === 1 || end <= first) return;
  const half = first + (leaves / 2) * leaf;
  if (half < end) select(order, middles, widestAxis(order, middles, first, end), first, end - 1, half);
  split(order, middles, first, leaves / 2, leaf);
  split(order, middles, half, leaves / 2, leaf);
}

function widestAxis(order, middles, first, end) {
  const count = Math.min(SAMPLES, end - first), trimmed = count === SAMPLES ? TRIMMED : 0;
  const widths = [0, 1, 2].map((axis) => {
    const values = Float64Array.from({ length: count }, (_, k) => middles[3 * order[first + Math.floor((k * (end - first)) / count)] + axis]).sort();
    return values[count - 1 - trimmed] - values[trimmed];
  });
  return widths.indexOf(Math.max(...widths));
}

// Puts what is less than number k of low to high before it, and what is more behind it (Hoare 1961).
function select(order, middles, axis, low, high, k) {
  while (low < high) {
    const pivot = middles[3 * order[(low + high) >> 1] + axis];
    let i = low, j = high;
    while (i <= j) {
      while (middles[3 * order[i] + axis] < pivot) i++;
      while (middles[3 * order[j] + axis] > pivot) j--;
      if (i <= j) {
        [order[i], order[j]] = [order[j], order[i]];
        i++;
        j--;
      }
    }
    if (k <= j) high = j;
    else if (k >= i) low = i;
    else return;
  }
}
