// Layer normalization of rows of x (n, dim): one warp a row.

// Mean and inverse standard deviation of a row, in all threads of its warp.
DEVICE void row_moments(const float *x, unsigned dim, unsigned lane, float epsilon, float *mean, float *scale) {
    float sum = 0.0f, squares = 0.0f;
    for (unsigned i = lane; i < dim; i += WARP) {
        sum += x[i];
    }
    *mean = warp_sum(sum) / (float)dim;
    for (unsigned i = lane; i < dim; i += WARP) {
        squares += (x[i] - *mean) * (x[i] - *mean);
    }
    *scale = 1.0f / sqrtf(warp_sum(squares) / (float)dim + epsilon);
}

// y = (x - mean) * scale * weight + bias, which may be halved.
KERNEL void layer_norm(const float *x, const float *weight, const float *bias, unsigned n, unsigned dim, float epsilon, unsigned halved,
                       void *y) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / WARP, lane = threadIdx.x % WARP;
    if (row >= n) {
        return;
    }
    size_t start = (size_t)row * dim;
    float mean, scale;
    row_moments(x + start, dim, lane, epsilon, &mean, &scale);
    for (unsigned i = lane; i < dim; i += WARP) {
        put_number(y, start + i, halved, (x[start + i] - mean) * scale * weight[i] + bias[i]);
    }
}

// The gradient at x from grad at y, which is halved where y is. Also writes normalized rows times the gradient, whose column sums are the gradient at the weight.
KERNEL void layer_norm_backward(const float *x, const float *weight, const void *grad, unsigned n, unsigned dim, float epsilon,
                                unsigned halved, float *dx, float *products) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / WARP, lane = threadIdx.x % WARP;
    if (row >= n) {
        return;
    }
    size_t start = (size_t)row * dim;
    float mean, scale, along_mean = 0.0f, along_x = 0.0f;
    row_moments(x + start, dim, lane, epsilon, &mean, &scale);
    for (unsigned i = lane; i < dim; i += WARP) {
        float normalized = (x[start + i] - mean) * scale, d = number_at(grad, start + i, halved) * weight[i];
        along_mean += d;
        along_x += d * normalized;
    }
    along_mean = warp_sum(along_mean) / (float)dim;
    along_x = warp_sum(along_x) / (float)dim;
    for (unsigned i = lane; i < dim; i += WARP) {
        float normalized = (x[start + i] - mean) * scale, g = number_at(grad, start + i, halved);
        dx[start + i] = scale * (g * weight[i] - along_mean - normalized * along_x);
        products[start + i] = normalized * g;
    }
}
