/* tests/layer/example.c -- the least that a program needs for a data graph: 1, 2, 3 + 10, 20, 30. */
#include <stdio.h>

#include "tests/layer/client.h"

/* OpExtInst ADD over two int32 tensors of three elements. */
static const uint32_t kWords[] = {
    0x07230203, 0x00010500, 0x00000000, 0x00000012, 0x00000000, 0x00020011, 0x0000105f, 0x00020011,
    0x0000104e, 0x00020011, 0x00000001, 0x0005000a, 0x5f565053, 0x5f4d5241, 0x70617267, 0x00000068,
    0x0005000a, 0x5f565053, 0x5f4d5241, 0x736e6574, 0x0073726f, 0x0006000b, 0x00000001, 0x41534f54,
    0x3130302e, 0x2e303030, 0x00000031, 0x0003000e, 0x00000000, 0x00000003, 0x00040047, 0x00000002,
    0x00000022, 0x00000000, 0x00040047, 0x00000002, 0x00000021, 0x00000000, 0x00040047, 0x00000003,
    0x00000022, 0x00000000, 0x00040047, 0x00000003, 0x00000021, 0x00000001, 0x00040047, 0x00000004,
    0x00000022, 0x00000000, 0x00040047, 0x00000004, 0x00000021, 0x00000002, 0x00040015, 0x00000005,
    0x00000020, 0x00000000, 0x0004002b, 0x00000005, 0x00000006, 0x00000000, 0x0004002b, 0x00000005,
    0x00000007, 0x00000001, 0x0004002b, 0x00000005, 0x00000008, 0x00000003, 0x0004001c, 0x00000009,
    0x00000005, 0x00000007, 0x0004002c, 0x00000009, 0x0000000a, 0x00000008, 0x00051043, 0x0000000b,
    0x00000005, 0x00000007, 0x0000000a, 0x00040020, 0x0000000c, 0x00000000, 0x0000000b, 0x0004003b,
    0x0000000c, 0x00000002, 0x00000000, 0x0004003b, 0x0000000c, 0x00000003, 0x00000000, 0x0004003b,
    0x0000000c, 0x00000004, 0x00000000, 0x0006105e, 0x0000000d, 0x00000002, 0x0000000b, 0x0000000b,
    0x0000000b, 0x00071056, 0x0000000e, 0x6e69616d, 0x00000000, 0x00000002, 0x00000003, 0x00000004,
    0x00031057, 0x0000000d, 0x0000000e, 0x00041058, 0x0000000b, 0x0000000f, 0x00000006, 0x00041058,
    0x0000000b, 0x00000010, 0x00000007, 0x0007000c, 0x0000000b, 0x00000011, 0x00000001, 0x0000000e,
    0x0000000f, 0x00000010, 0x00031059, 0x00000011, 0x00000006, 0x0001105a,
};

typedef struct Call {
  const Client* client;
  const ClientGraph* graph;
} Call;

static void record(VkCommandBuffer commands, void* user) {
  const Call* call = user;
  client_record_graph(call->client, commands, call->graph);
}

int main(void) {
  Client client;
  if (client_open(&client, NULL) != VK_SUCCESS) {
    fputs("no device has VK_ARM_tensors and VK_ARM_data_graph\n", stderr);
    return 3;
  }
  const int64_t dims[] = {3};
  ClientTensor tensors[3];
  const VkTensorDescriptionARM* descriptions[3];
  VkTensorViewARM views[3];
  for (int i = 0; i < 3; ++i) {
    if (client_create_tensor(&client, VK_FORMAT_R32_SINT, VK_TENSOR_TILING_LINEAR_ARM, 1, dims,
                             NULL, &tensors[i]) != VK_SUCCESS)
      return 1;
    descriptions[i] = &tensors[i].description;
    views[i] = tensors[i].view;
  }
  const ClientGraphInfo info = {.words = kWords,
                                .word_count = sizeof kWords / sizeof *kWords,
                                .entry_point = "main",
                                .tensor_count = 3,
                                .descriptions = descriptions};
  ClientGraph graph;
  if (client_create_graph(&client, &info, &graph) != VK_SUCCESS) {
    fprintf(stderr, "%s\n", client.last_message);
    return 1;
  }
  client_write_set(&client, &graph, 3, views);
  int32_t *a = tensors[0].mapped, *b = tensors[1].mapped;
  const int32_t* sum = tensors[2].mapped;
  for (int i = 0; i < 3; ++i) a[i] = i + 1, b[i] = 10 * (i + 1);
  Call call = {&client, &graph};
  if (client_submit(&client, record, &call) != VK_SUCCESS) {
    fprintf(stderr, "%s\n", client.last_message);
    return 1;
  }
  printf("%d %d %d\n", sum[0], sum[1], sum[2]);
  const int correct = sum[0] == 11 && sum[1] == 22 && sum[2] == 33;
  client_destroy_graph(&client, &graph);
  for (int i = 0; i < 3; ++i) client_destroy_tensor(&client, &tensors[i]);
  client_close(&client);
  return correct ? 0 : 1;
}
