// Runs a kernel on the host, for tests: every thread of a block has a stack of its own, and they take turns at __syncthreads and at
// exchanges between the threads of a warp. Reads a call from stdin and writes the buffers, as the kernel left them, to stdout.
//
// Buffers lie between fences of NaN, whose halves are NaN too: what is read beyond an end shows in the result, and what is written there is an error. Threads run in
// ascending or descending order: a missing barrier shows as a difference.

#define _XOPEN_SOURCE 700
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#define KERNEL static
#define DEVICE static
#define SHARED(name) float *name = shared_memory
#define MAX_THREADS 1024
#define STACK (64 * 1024)
#define FENCE 256
#define MAX_ARGUMENTS 32
#define FENCE_BITS 0x7fc07fc0u

static float shared_memory[12 * 1024 + FENCE]; // 48 KiB, which every GPU has
static struct {
    unsigned x, y;
} blockIdx, gridDim, blockDim, threadIdx;

static unsigned min(unsigned a, unsigned b) {
    return a < b ? a : b;
}

static void fail(const char *what) {
    fprintf(stderr, "%s\n", what);
    exit(1);
}

enum Wait { RUNS, AT_BLOCK, AT_WARP, DONE };
static enum Wait waits[MAX_THREADS];
static ucontext_t scheduler, threads[MAX_THREADS];
static float exchanged[MAX_THREADS];

static void wait_at(enum Wait what) {
    unsigned thread = threadIdx.x;
    waits[thread] = what;
    swapcontext(&threads[thread], &scheduler);
}

static float __uint_as_float(unsigned bits) {
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

static unsigned __float_as_uint(float number) {
    unsigned bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

static void __syncthreads(void) {
    wait_at(AT_BLOCK);
}

static float __shfl_xor_sync(unsigned mask, float x, int apart) {
    unsigned thread = threadIdx.x;
    if (mask != 0xffffffffu || apart <= 0 || apart >= 32) {
        fail("only whole warps exchange");
    }
    exchanged[thread] = x;
    wait_at(AT_WARP);
    float other = exchanged[thread ^ (unsigned)apart];
    wait_at(AT_WARP);
    return other;
}

#include "common.cu"

#include "adam.cu"
#include "attention.cu"
#include "layer_norm.cu"
#include "linear.cu"
#include "sinusoidal.cu"

typedef struct {
    char tag; // b: buffer (of floats, or halved numbers two by two), u: unsigned, f: float
    unsigned number;
    float real;
    float *buffer;
} Argument;

static Argument arguments[MAX_ARGUMENTS];
static unsigned n_arguments;
static char kernel[64];

static Argument *argument(unsigned i, char tag) {
    if (arguments[i].tag != tag) {
        fprintf(stderr, "argument %u of %s is of another type\n", i, kernel);
        exit(1);
    }
    return &arguments[i];
}

#define B(i) argument(i, 'b')->buffer
#define U(i) argument(i, 'u')->number
#define F(i) argument(i, 'f')->real
#define CALL(name, n, ...)                        \
    if (strcmp(kernel, #name) == 0) {             \
        if (n_arguments != n) {                   \
            fail(#name " takes " #n " arguments"); \
        }                                         \
        name(__VA_ARGS__);                        \
        waits[threadIdx.x] = DONE;                \
        return;                                   \
    }

static void run_thread(void) {
    CALL(column_sums, 6, B(0), U(1), U(2), U(3), U(4), B(5))
    CALL(layer_norm, 8, B(0), B(1), B(2), U(3), U(4), F(5), U(6), B(7))
    CALL(layer_norm_backward, 9, B(0), B(1), B(2), U(3), U(4), F(5), U(6), B(7), B(8))
    CALL(bias_activation, 10, B(0), B(1), B(2), U(3), U(4), U(5), U(6), U(7), U(8), B(9))
    CALL(bias_activation_backward, 9, B(0), B(1), B(2), U(3), U(4), U(5), U(6), U(7), B(8))
    CALL(sinusoidal, 6, B(0), B(1), B(2), U(3), U(4), B(5))
    CALL(sinusoidal_backward, 6, B(0), B(1), B(2), U(3), U(4), B(5))
    CALL(adam, 13, B(0), B(1), B(2), B(3), U(4), F(5), F(6), F(7), F(8), F(9), F(10), F(11), F(12))
    CALL(average, 5, B(0), B(1), U(2), F(3), F(4))
    CALL(sums_of_squares, 4, B(0), U(1), U(2), B(3))
    CALL(attention, 21, B(0), B(1), B(2), B(3), U(4), U(5), U(6), U(7), U(8), U(9), U(10), U(11), U(12), U(13), U(14), U(15), U(16),
         U(17), F(18), B(19), B(20))
    CALL(attention_backward_queries, 25, B(0), B(1), B(2), B(3), B(4), B(5), B(6), U(7), U(8), U(9), U(10), U(11), U(12), U(13), U(14),
         U(15), U(16), U(17), U(18), U(19), U(20), F(21), U(22), B(23), B(24))
    CALL(attention_backward_keys, 24, B(0), B(1), B(2), B(3), B(4), B(5), B(6), U(7), U(8), U(9), U(10), U(11), U(12), U(13), U(14),
         U(15), U(16), U(17), U(18), U(19), U(20), F(21), U(22), B(23))
    fail("unknown kernel");
}

// Lets go on whom nothing holds up any more; whether there was anyone.
static int release(void) {
    int all_at_block = 1, any = 0;
    for (unsigned t = 0; t < blockDim.x; t++) {
        all_at_block = all_at_block && (waits[t] == AT_BLOCK || waits[t] == DONE);
    }
    for (unsigned t = 0; t < blockDim.x; t++) {
        int whole_warp = waits[t] == AT_WARP;
        for (unsigned other = t / 32 * 32; other < t / 32 * 32 + 32 && whole_warp; other++) {
            whole_warp = other < blockDim.x && (waits[other] == AT_WARP || (other < t && waits[other] == RUNS));
        }
        if (whole_warp || (all_at_block && waits[t] == AT_BLOCK)) {
            waits[t] = RUNS;
            any = 1;
        }
    }
    return any;
}

static void run_block(char *stacks, int descending) {
    for (unsigned t = 0; t < blockDim.x; t++) {
        getcontext(&threads[t]);
        threads[t].uc_stack.ss_sp = stacks + (size_t)t * STACK;
        threads[t].uc_stack.ss_size = STACK;
        threads[t].uc_link = &scheduler;
        makecontext(&threads[t], run_thread, 0);
        waits[t] = RUNS;
    }
    do {
        for (unsigned i = 0; i < blockDim.x; i++) {
            unsigned t = descending ? blockDim.x - 1 - i : i;
            if (waits[t] == RUNS) {
                threadIdx.x = t;
                swapcontext(&scheduler, &threads[t]);
            }
        }
    } while (release());
    for (unsigned t = 0; t < blockDim.x; t++) {
        if (waits[t] != DONE) {
            fail("threads of a block wait for each other");
        }
    }
}

static void get(void *to, size_t size) {
    if (fread(to, 1, size, stdin) != size) {
        fail("the call ends early");
    }
}

static unsigned get_number(void) {
    unsigned number;
    get(&number, sizeof number);
    return number;
}

static void check_fence(const float *fence) {
    for (unsigned i = 0; i < FENCE; i++) {
        if (__float_as_uint(fence[i]) != FENCE_BITS) {
            fail("written beyond the end of a buffer");
        }
    }
}

int main(void) {
    get(kernel, sizeof kernel);
    gridDim.x = get_number(), gridDim.y = get_number(), blockDim.x = get_number();
    unsigned n_shared = get_number(), descending = get_number();
    n_arguments = get_number();
    if (n_arguments > MAX_ARGUMENTS || blockDim.x > MAX_THREADS || n_shared > 12 * 1024) {
        fail("the call is too large");
    }
    unsigned lengths[MAX_ARGUMENTS];
    for (unsigned i = 0; i < n_arguments; i++) {
        Argument *a = &arguments[i];
        get(&a->tag, 1);
        if (a->tag == 'u') {
            a->number = get_number();
        } else if (a->tag == 'f') {
            get(&a->real, sizeof a->real);
        } else {
            lengths[i] = get_number();
            float *memory = malloc((lengths[i] + 2 * FENCE) * sizeof(float));
            for (unsigned j = 0; j < FENCE; j++) {
                memory[j] = memory[FENCE + lengths[i] + j] = __uint_as_float(FENCE_BITS);
            }
            a->buffer = memory + FENCE;
            get(a->buffer, lengths[i] * sizeof(float));
        }
    }
    char *stacks = malloc((size_t)blockDim.x * STACK);
    for (blockIdx.y = 0; blockIdx.y < gridDim.y; blockIdx.y++) {
        for (blockIdx.x = 0; blockIdx.x < gridDim.x; blockIdx.x++) {
            for (unsigned i = 0; i < sizeof shared_memory / sizeof(float); i++) {
                shared_memory[i] = __uint_as_float(FENCE_BITS);
            }
            run_block(stacks, (int)descending);
            check_fence(shared_memory + n_shared);
        }
    }
    for (unsigned i = 0; i < n_arguments; i++) {
        if (arguments[i].tag == 'b') {
            check_fence(arguments[i].buffer - FENCE);
            check_fence(arguments[i].buffer + lengths[i]);
            fwrite(arguments[i].buffer, sizeof(float), lengths[i], stdout);
        }
    }
    return fflush(stdout) != 0;
}
