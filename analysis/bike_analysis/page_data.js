// Columns of numbers as `embed.py` writes them, and what is drawn of them.

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

// Lowest and highest row of each block of 64, so that an hour is searched as quickly as a minute.
const BLOCK = 64;
const blockTables = new WeakMap();

function blocksOf(column) {
  let table = blockTables.get(column);
  if (table) return table;
  const count = Math.floor(column.length / BLOCK);
  table = { low: new Int32Array(count), high: new Int32Array(count) };
  for (let block = 0; block < count; block++) {
    [table.low[block], table.high[block]] = extremeRows(column, block * BLOCK, (block + 1) * BLOCK);
  }
  blockTables.set(column, table);
  return table;
}

// Rows of the smallest and the largest value in [first, end); -1 where all are missing.
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

function extremesByBlocks(column, first, end) {
  const from = Math.ceil(first / BLOCK), to = Math.floor(end / BLOCK);
  if (to <= from) return extremeRows(column, first, end);
  const table = blocksOf(column);
  let [low, high] = extremeRows(column, first, from * BLOCK);
  const offer = (below, above) => {
    if (below >= 0 && (low < 0 || column[below] < column[low])) low = below;
    if (above >= 0 && (high < 0 || column[above] > column[high])) high = above;
  };
  for (let block = from; block < to; block++) offer(table.low[block], table.high[block]);
  offer(...extremeRows(column, to * BLOCK, end));
  return [low, high];
}

// The line as drawn: everything where there are few rows, else the extremes of each bucket, so no peak is lost.
function thinned(x, y, first, end, buckets) {
  if (end - first <= 2 * buckets) return { x: x.subarray(first, end), y: y.subarray(first, end), whole: true };
  const tx = [], ty = [];
  const add = row => { tx.push(x[row]); ty.push(y[row]); };
  add(first);
  for (let bucket = 0; bucket < buckets; bucket++) {
    const from = first + Math.floor((end - first) * bucket / buckets);
    const to = first + Math.floor((end - first) * (bucket + 1) / buckets);
    const [low, high] = extremesByBlocks(y, from, to);
    if (low < 0) { add(from); continue; }
    add(Math.min(low, high));
    if (low !== high) add(Math.max(low, high));
  }
  add(end - 1);
  return { x: tx, y: ty, whole: false };
}

function span(column, first = 0, end = column.length) {
  const [low, high] = extremesByBlocks(column, first, end);
  return low < 0 ? [0, 1] : [column[low], column[high]];
}
