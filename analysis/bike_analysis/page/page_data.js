// Columns of numbers as `html.py` embeds them, and what is drawn of them.

const MISSING = -(2 ** 31);

function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

// A column holds multiples of a quantum: zigzag differences, split into four planes of bytes, deflated.
async function decoded(column) {
  const stream = new Blob([bytesOf(column.data)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const n = column.rows, values = new Float64Array(n);
  for (let i = 0, sum = 0; i < n; i++) {
    const z = bytes[i] | bytes[n + i] << 8 | bytes[2 * n + i] << 16 | bytes[3 * n + i] << 24;
    sum = (sum + ((z >>> 1) ^ -(z & 1))) | 0;
    values[i] = sum === MISSING ? NaN : sum * column.quantum;
  }
  return values;
}

async function decodedAll(columns) {
  const names = Object.keys(columns), values = await Promise.all(names.map(name => decoded(columns[name])));
  return Object.fromEntries(names.map((name, i) => [name, values[i]]));
}

// First row whose value is not below `wanted`, in a column that never falls.
function rowOf(column, wanted) {
  let low = 0, high = column.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (column[middle] < wanted) low = middle + 1; else high = middle;
  }
  return low;
}

function nearestRow(column, wanted) {
  const row = Math.min(rowOf(column, wanted), column.length - 1);
  return row > 0 && wanted - column[row - 1] < column[row] - wanted ? row - 1 : row;
}

// A pyramid over each column: rows of the smallest and the largest value of each 4, 8, 16 … rows, so that an hour is
// searched as quickly as a minute. -1 stands for no row: all values are missing.
const CELL = 4;
const pyramids = new WeakMap();
const lower = (column, a, b) => b < 0 || (a >= 0 && column[a] <= column[b]) ? a : b;
const higher = (column, a, b) => b < 0 || (a >= 0 && column[a] >= column[b]) ? a : b;

function pyramidOf(column) {
  let levels = pyramids.get(column);
  if (levels) return levels;
  levels = [];
  for (let count = Math.floor(column.length / CELL); count >= 1; count >>= 1) {
    const below = levels[levels.length - 1], low = new Int32Array(count), high = new Int32Array(count);
    for (let cell = 0; cell < count; cell++) {
      if (below) {
        low[cell] = lower(column, below.low[2 * cell], below.low[2 * cell + 1]);
        high[cell] = higher(column, below.high[2 * cell], below.high[2 * cell + 1]);
      } else [low[cell], high[cell]] = extremeRows(column, cell * CELL, (cell + 1) * CELL);
    }
    levels.push({ low, high });
  }
  pyramids.set(column, levels);
  return levels;
}

// Rows of the smallest and the largest value in [first, end), each looked at.
function extremeRows(column, first, end) {
  let low = -1, high = -1;
  for (let i = first; i < end; i++) {
    const value = column[i];
    if (value !== value) continue;
    if (low < 0 || value < column[low]) low = i;
    if (high < 0 || value > column[high]) high = i;
  }
  return [low, high];
}

// The same by the pyramid: single rows at the ends, then at most two cells of each level.
function extremesIn(column, first, end) {
  let from = Math.ceil(first / CELL), to = Math.floor(end / CELL);
  if (to <= from) return extremeRows(column, first, end);
  let [low, high] = extremeRows(column, first, from * CELL);
  const offer = (below, above) => { low = lower(column, low, below); high = higher(column, high, above); };
  offer(...extremeRows(column, to * CELL, end));
  for (const level of pyramidOf(column)) {
    if (from >= to) break;
    if (from & 1) { offer(level.low[from], level.high[from]); from++; }
    if (to & 1) { to--; offer(level.low[to], level.high[to]); }
    from >>= 1; to >>= 1;
  }
  return [low, high];
}

// The line as drawn: everything where there are few rows, else the extremes of each cell of the pyramid, so no peak is
// lost. The level is the finest with at most so many cells; they lie fast in the column, so nothing flickers in a pan.
function thinned(x, y, first, end, cells) {
  if (end - first <= 2 * cells) return { x: x.subarray(first, end), y: y.subarray(first, end), whole: true };
  const level = Math.ceil(Math.log2((end - first) / cells / CELL)), size = CELL * 2 ** level, tx = [], ty = [];
  const { low, high } = pyramidOf(y)[level], from = Math.ceil(first / size), to = Math.floor(end / size);
  const add = row => { tx.push(x[row]); ty.push(y[row]); };
  const both = (below, above, instead) => {
    if (below < 0) { add(instead); return; }
    add(Math.min(below, above));
    if (below !== above) add(Math.max(below, above));
  };
  add(first);
  if (first < from * size) both(...extremesIn(y, first, from * size), first);
  for (let cell = from; cell < to; cell++) both(low[cell], high[cell], cell * size);
  if (to * size < end) both(...extremesIn(y, to * size, end), end - 1);
  add(end - 1);
  return { x: tx, y: ty, whole: false };
}

function span(column, first = 0, end = column.length) {
  const [low, high] = extremesIn(column, first, end);
  return low < 0 ? [0, 1] : [column[low], column[high]];
}

// A column less another one that is interpolated at the same places; missing beyond the other's ends.
function minus(places, values, otherPlaces, otherValues) {
  const last = otherPlaces.length - 1, result = new Float64Array(places.length);
  for (let i = 0, k = 0; i < places.length; i++) {
    const at = places[i];
    while (k < last - 1 && otherPlaces[k + 1] < at) k++;
    const from = otherPlaces[k], share = (at - from) / (otherPlaces[k + 1] - from || 1);
    result[i] = at < otherPlaces[0] || at > otherPlaces[last] ? NaN
      : values[i] - otherValues[k] - share * (otherValues[k + 1] - otherValues[k]);
  }
  return result;
}
