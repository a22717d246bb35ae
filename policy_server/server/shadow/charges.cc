#include "policy_server/server/shadow/charges.h"

#include "policy_server/server/flight/flight_ring.h"

namespace rips::shadow {
namespace {

// About what a participant, node or endpoint with its names takes in a graph.
constexpr size_t kEntryBytes = 256;

size_t GraphBytes(const ros2::RosGraph& graph) {
  return kEntryBytes *
         (1 + graph.participants().size() + graph.nodes().size() + graph.endpoints().size());
}

}  // namespace

ChargePtr Charges::OfBatch(const pipeline::Batch* batch) {
  if (batch == nullptr) return nullptr;
  if (batch_.of == batch) {
    if (ChargePtr charge = batch_.charge.lock()) return charge;
  }
  auto charge = std::make_shared<const Charge>(&bytes_, flight::BytesOf(*batch));
  batch_ = {.of = batch, .charge = charge};
  return charge;
}

ChargePtr Charges::OfGraph(const ros2::RosGraph* graph) {
  if (graph == nullptr) return nullptr;
  for (const Charged& each : graphs_) {
    if (each.of != graph) continue;
    if (ChargePtr charge = each.charge.lock()) return charge;
  }
  auto charge = std::make_shared<const Charge>(&bytes_, GraphBytes(*graph));
  graphs_[next_graph_] = {.of = graph, .charge = charge};
  next_graph_ = (next_graph_ + 1) % graphs_.size();
  return charge;
}

}  // namespace rips::shadow
