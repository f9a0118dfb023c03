/* A plugin of QEMU: how often each block of instructions runs, into the file "blocks": a line a
 * block, with its count and the addresses of its instructions.
 *
 * The declarations are those of qemu-plugin.h, version 1 of the interface.
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

struct qemu_plugin_tb;
struct qemu_plugin_insn;
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *tb);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *tb, size_t index);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *insn);
void qemu_plugin_register_vcpu_tb_trans_cb(uint64_t id,
                                           void (*call)(uint64_t, struct qemu_plugin_tb *));
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *tb, void (*call)(unsigned, void *),
                                          int flags, void *data);
void qemu_plugin_register_atexit_cb(uint64_t id, void (*call)(uint64_t, void *), void *data);
int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv);

int qemu_plugin_version = 1;

struct block {
    struct block *next;
    uint64_t count;
    size_t size;
    uint64_t addresses[];
};

static struct block *blocks;

static void run(unsigned processor, void *block)
{
    (void)processor;
    ((struct block *)block)->count++;
}

static void translate(uint64_t id, struct qemu_plugin_tb *tb)
{
    const size_t size = qemu_plugin_tb_n_insns(tb);
    struct block *const block = calloc(1, sizeof *block + size * sizeof block->addresses[0]);

    (void)id;
    if (block == NULL) {
        abort();
    }
    block->size = size;
    for (size_t i = 0; i < size; i++) {
        block->addresses[i] = qemu_plugin_insn_vaddr(qemu_plugin_tb_get_insn(tb, i));
    }
    block->next = blocks;
    blocks = block;
    qemu_plugin_register_vcpu_tb_exec_cb(tb, run, 0, block);
}

static void end(uint64_t id, void *data)
{
    FILE *const file = fopen("blocks", "w");

    (void)id;
    (void)data;
    for (const struct block *each = blocks; file != NULL && each != NULL; each = each->next) {
        fprintf(file, "%" PRIu64, each->count);
        for (size_t i = 0; i < each->size; i++) {
            fprintf(file, " %" PRIx64, each->addresses[i]);
        }
        fputc('\n', file);
    }
    if (file != NULL) {
        fclose(file);
    }
}

int qemu_plugin_install(uint64_t id, const void *info, int argc, char **argv)
{
    (void)info;
    (void)argc;
    (void)argv;
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    qemu_plugin_register_atexit_cb(id, end, NULL);
    return 0;
}
