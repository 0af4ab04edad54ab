// What follows and precedes the matrix products of a linear map of rows (n, n_out): one thread a number.

// y = activation(product + bias), and exactly 0 where valid (n) is 0, unless all_valid.
KERNEL void bias_activation(const float *product, const float *bias, const float *valid, unsigned n, unsigned n_out, unsigned relu,
                            unsigned all_valid, float *y) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (size_t)n * n_out) {
        return;
    }
    float value = product[i] + bias[i % n_out];
    if (relu) {
        value = fmaxf(value, 0.0f);
    }
    y[i] = all_valid || valid[i / n_out] != 0.0f ? value : 0.0f;
}

// The gradient before the activation, from grad at its result y.
KERNEL void bias_activation_backward(const float *y, const float *grad, const float *valid, unsigned n, unsigned n_out, unsigned relu,
                                     unsigned all_valid, float *before) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x;
    if (i >= (size_t)n * n_out) {
        return;
    }
    int passes = (all_valid || valid[i / n_out] != 0.0f) && (!relu || y[i] > 0.0f);
    before[i] = passes ? grad[i] : 0.0f;
}
