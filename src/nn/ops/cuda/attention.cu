// Softmax attention of groups of queries to groups of keys, both with masks, without ever storing the weights (Dao et al. 2022).
// HEAD_DIM features a head are known when this is compiled: a thread keeps a query or a key in registers.
//
// Groups. Query i of group g is row (g / inner) * outer + (g % inner) * between + i * step of its matrix, and likewise for keys: a
// matrix is read along time, along agents or as a whole by its strides, and nothing is copied before.
//
// Blocks. Block (g * n_heads + head, tile) of gridDim.x by gridDim.y; its threads own blockDim.x queries (or keys) of the tile, and the
// other side comes through shared memory, TILE rows at a time, which all threads read in step.

#define TILE 32
#define LOWEST -3.402823466e38f
// Unrolled, because only arrays with constant indices can be registers.
#define EACH_FEATURE(c) _Pragma("unroll") for (unsigned c = 0; c < HEAD_DIM; c++)

// Where a group's rows are.
typedef struct {
    size_t first;
    unsigned step;
} Rows;

DEVICE Rows rows_of(unsigned group, unsigned inner, unsigned outer, unsigned between, unsigned step) {
    Rows rows;
    rows.first = (size_t)(group / inner) * outer + (size_t)(group % inner) * between;
    rows.step = step;
    return rows;
}

DEVICE size_t row_at(Rows rows, unsigned i) {
    return rows.first + (size_t)i * rows.step;
}

// Copies columns from `column` on of rows `start` to `start` + TILE - 1 of a group into a tile (TILE, HEAD_DIM).
DEVICE void load_tile(float *tile, const float *m, unsigned width, unsigned column, Rows rows, unsigned start, unsigned n) {
    for (unsigned i = threadIdx.x; i < TILE * HEAD_DIM; i += blockDim.x) {
        unsigned row = start + i / HEAD_DIM;
        tile[i] = row < n ? m[row_at(rows, row) * width + column + i % HEAD_DIM] : 0.0f;
    }
}

// One number of each of the rows `start` to `start` + TILE - 1, 0 behind the last.
DEVICE void load_numbers(float *numbers, const float *m, unsigned width, unsigned column, Rows rows, unsigned start, unsigned n) {
    for (unsigned i = threadIdx.x; i < TILE; i += blockDim.x) {
        numbers[i] = start + i < n ? m[row_at(rows, start + i) * width + column] : 0.0f;
    }
}

DEVICE void load_row(float *row, const float *m, size_t start) {
    EACH_FEATURE(c) {
        row[c] = m[start + c];
    }
}

DEVICE float dot(const float *a, const float *b) {
    float sum = 0.0f;
    EACH_FEATURE(c) {
        sum += a[c] * b[c];
    }
    return sum;
}

DEVICE void add_scaled(float *sum, float scale, const float *a) {
    EACH_FEATURE(c) {
        sum[c] += scale * a[c];
    }
}

// Queries (rows of q_width, head h from column h * HEAD_DIM), keys and values (rows of kv_width, from key_column and value_column on) to
// mixed (rows of n_heads * HEAD_DIM) and log_sums (rows, n_heads): the logarithm of the sum of the exponentials of the scores. Masked
// queries, and those without a key, get 0.
KERNEL void attention(const float *q, const float *q_valid, const float *kv, const float *k_valid, unsigned n_heads, unsigned q_width,
                      unsigned kv_width, unsigned key_column, unsigned value_column, unsigned n_queries, unsigned n_keys, unsigned inner,
                      unsigned q_outer, unsigned q_between, unsigned q_step, unsigned k_outer, unsigned k_between, unsigned k_step,
                      float scale, float *mixed, float *log_sums) {
    SHARED(keys);
    float *values = keys + TILE * HEAD_DIM, *is_key = values + TILE * HEAD_DIM;
    unsigned group = blockIdx.x / n_heads, head = blockIdx.x % n_heads;
    unsigned i = blockIdx.y * blockDim.x + threadIdx.x;
    Rows q_rows = rows_of(group, inner, q_outer, q_between, q_step), k_rows = rows_of(group, inner, k_outer, k_between, k_step);
    size_t row = row_at(q_rows, i < n_queries ? i : 0);
    int serves = i < n_queries && q_valid[row] != 0.0f;
    float query[HEAD_DIM], sum[HEAD_DIM], largest = LOWEST, total = 0.0f;
    EACH_FEATURE(c) {
        query[c] = serves ? q[row * q_width + head * HEAD_DIM + c] * scale : 0.0f;
        sum[c] = 0.0f;
    }
    for (unsigned start = 0; start < n_keys; start += TILE) {
        __syncthreads();
        load_tile(keys, kv, kv_width, key_column + head * HEAD_DIM, k_rows, start, n_keys);
        load_tile(values, kv, kv_width, value_column + head * HEAD_DIM, k_rows, start, n_keys);
        load_numbers(is_key, k_valid, 1, 0, k_rows, start, n_keys);
        __syncthreads();
        for (unsigned j = 0; j < TILE; j++) {
            if (is_key[j] == 0.0f) {
                continue;
            }
            float score = dot(query, keys + j * HEAD_DIM);
            if (score > largest) {
                // What was summed so far was relative to a smaller score.
                float shrink = expf(largest - score);
                total *= shrink;
                EACH_FEATURE(c) {
                    sum[c] *= shrink;
                }
                largest = score;
            }
            float weight = expf(score - largest);
            total += weight;
            add_scaled(sum, weight, values + j * HEAD_DIM);
        }
    }
    if (i < n_queries) {
        float inverse = serves && total != 0.0f ? 1.0f / total : 0.0f; // NaN stays NaN
        EACH_FEATURE(c) {
            mixed[(row * n_heads + head) * HEAD_DIM + c] = inverse == 0.0f ? 0.0f : sum[c] * inverse;
        }
        log_sums[row * n_heads + head] = inverse == 0.0f ? 0.0f : largest + logf(total);
    }
}

// The gradient at the queries, a thread a query, into dq (rows of dq_width, head h from column h * HEAD_DIM), from grad at mixed. Also
// writes along (rows, n_heads), the product of grad and mixed, which the gradient at the keys needs.
KERNEL void attention_backward_queries(const float *q, const float *q_valid, const float *kv, const float *k_valid, const float *mixed,
                                       const float *log_sums, const float *grad, unsigned n_heads, unsigned q_width, unsigned kv_width,
                                       unsigned key_column, unsigned value_column, unsigned n_queries, unsigned n_keys, unsigned inner,
                                       unsigned q_outer, unsigned q_between, unsigned q_step, unsigned k_outer, unsigned k_between,
                                       unsigned k_step, float scale, unsigned dq_width, float *dq, float *along) {
    SHARED(keys);
    float *values = keys + TILE * HEAD_DIM, *is_key = values + TILE * HEAD_DIM;
    unsigned group = blockIdx.x / n_heads, head = blockIdx.x % n_heads;
    unsigned i = blockIdx.y * blockDim.x + threadIdx.x;
    Rows q_rows = rows_of(group, inner, q_outer, q_between, q_step), k_rows = rows_of(group, inner, k_outer, k_between, k_step);
    size_t row = row_at(q_rows, i < n_queries ? i : 0);
    int serves = i < n_queries && q_valid[row] != 0.0f;
    float query[HEAD_DIM], at_mixed[HEAD_DIM], sum[HEAD_DIM], product = 0.0f;
    EACH_FEATURE(c) {
        size_t place = (row * n_heads + head) * HEAD_DIM + c;
        query[c] = serves ? q[row * q_width + head * HEAD_DIM + c] : 0.0f;
        at_mixed[c] = serves ? grad[place] : 0.0f;
        product += serves ? at_mixed[c] * mixed[place] : 0.0f;
        sum[c] = 0.0f;
    }
    float log_sum = log_sums[row * n_heads + head];
    for (unsigned start = 0; start < n_keys; start += TILE) {
        __syncthreads();
        load_tile(keys, kv, kv_width, key_column + head * HEAD_DIM, k_rows, start, n_keys);
        load_tile(values, kv, kv_width, value_column + head * HEAD_DIM, k_rows, start, n_keys);
        load_numbers(is_key, k_valid, 1, 0, k_rows, start, n_keys);
        __syncthreads();
        for (unsigned j = 0; j < TILE; j++) {
            if (!serves || is_key[j] == 0.0f) {
                continue;
            }
            float weight = expf(scale * dot(query, keys + j * HEAD_DIM) - log_sum);
            add_scaled(sum, weight * (dot(at_mixed, values + j * HEAD_DIM) - product) * scale, keys + j * HEAD_DIM);
        }
    }
    if (i < n_queries) {
        EACH_FEATURE(c) {
            dq[row * dq_width + head * HEAD_DIM + c] = sum[c];
        }
        along[row * n_heads + head] = product;
    }
}

// The gradients at keys and values, a thread a key, into dkv (rows of dkv_width, from key_column and value_column on). Keys first and
// values after them, lest a thread need registers for both at once.
KERNEL void attention_backward_keys(const float *q, const float *q_valid, const float *kv, const float *k_valid, const float *log_sums,
                                    const float *grad, const float *along, unsigned n_heads, unsigned q_width, unsigned kv_width,
                                    unsigned key_column, unsigned value_column, unsigned n_queries, unsigned n_keys, unsigned inner,
                                    unsigned q_outer, unsigned q_between, unsigned q_step, unsigned k_outer, unsigned k_between,
                                    unsigned k_step, float scale, unsigned dkv_width, float *dkv) {
    SHARED(queries);
    float *at_mixed = queries + TILE * HEAD_DIM, *is_query = at_mixed + TILE * HEAD_DIM;
    float *log_sum = is_query + TILE, *product = log_sum + TILE;
    unsigned group = blockIdx.x / n_heads, head = blockIdx.x % n_heads, width = n_heads * HEAD_DIM;
    unsigned j = blockIdx.y * blockDim.x + threadIdx.x;
    Rows q_rows = rows_of(group, inner, q_outer, q_between, q_step), k_rows = rows_of(group, inner, k_outer, k_between, k_step);
    size_t row = row_at(k_rows, j < n_keys ? j : 0);
    int serves = j < n_keys && k_valid[row] != 0.0f;
    size_t key_start = row * kv_width + key_column + head * HEAD_DIM, value_start = row * kv_width + value_column + head * HEAD_DIM;
    float key[HEAD_DIM], value[HEAD_DIM], sum[HEAD_DIM];
    load_row(key, kv, key_start);
    load_row(value, kv, value_start);
    for (unsigned of_values = 0; of_values < 2; of_values++) {
        EACH_FEATURE(c) {
            sum[c] = 0.0f;
        }
        for (unsigned start = 0; start < n_queries; start += TILE) {
            __syncthreads();
            load_tile(queries, q, q_width, head * HEAD_DIM, q_rows, start, n_queries);
            load_tile(at_mixed, grad, width, head * HEAD_DIM, q_rows, start, n_queries);
            load_numbers(is_query, q_valid, 1, 0, q_rows, start, n_queries);
            load_numbers(log_sum, log_sums, n_heads, head, q_rows, start, n_queries);
            load_numbers(product, along, n_heads, head, q_rows, start, n_queries);
            __syncthreads();
            for (unsigned i = 0; i < TILE; i++) {
                if (!serves || is_query[i] == 0.0f) {
                    continue;
                }
                float weight = expf(scale * dot(queries + i * HEAD_DIM, key) - log_sum[i]);
                if (of_values) {
                    add_scaled(sum, weight, at_mixed + i * HEAD_DIM);
                } else {
                    float at_score = weight * (dot(at_mixed + i * HEAD_DIM, value) - product[i]);
                    add_scaled(sum, at_score * scale, queries + i * HEAD_DIM);
                }
            }
        }
        if (j < n_keys) {
            size_t place = row * dkv_width + (of_values ? value_column : key_column) + head * HEAD_DIM;
            EACH_FEATURE(c) {
                dkv[place + c] = sum[c];
            }
        }
    }
}
