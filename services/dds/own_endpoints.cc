#include "services/dds/own_endpoints.h"

#include "services/ros2/ros_name.h"

namespace rips::dds {

OwnEndpoints::Entry OwnEndpoints::Add(absl::string_view topic, const ros2::Guid& guid,
                                      bool writer) {
  if (ros2::DemangleTopic(topic).kind == ros2::DdsTopicKind::kOther) return {};
  Change(guid, writer, /*there=*/true);
  return Entry(shared_from_this(), guid, writer);
}

void OwnEndpoints::Change(const ros2::Guid& guid, bool writer, bool there) {
  MutexLock lock(&mu_);
  absl::btree_set<ros2::Guid>& list = writer ? writers_ : readers_;
  if (there) {
    list.insert(guid);
  } else {
    list.erase(guid);
  }
  ++revision_;
}

OwnEndpoints::List OwnEndpoints::Now() const {
  MutexLock lock(&mu_);
  return {.revision = revision_,
          .readers = {readers_.begin(), readers_.end()},
          .writers = {writers_.begin(), writers_.end()}};
}

uint64_t OwnEndpoints::revision() const {
  MutexLock lock(&mu_);
  return revision_;
}

}  // namespace rips::dds
