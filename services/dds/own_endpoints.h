// The readers and writers of ROS topics and services that this process has in one participant.
#ifndef RIPS_SERVICES_DDS_OWN_ENDPOINTS_H_
#define RIPS_SERVICES_DDS_OWN_ENDPOINTS_H_

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_set.h"
#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"
#include "services/runtime/mutex.h"

namespace rips::dds {

// Any thread.
class OwnEndpoints : public std::enable_shared_from_this<OwnEndpoints> {
 public:
  struct List {
    // Changes whenever the rest does.
    uint64_t revision = 0;
    std::vector<ros2::Guid> readers;  // sorted
    std::vector<ros2::Guid> writers;
  };
  // An endpoint is listed while its entry lives.
  class Entry {
   public:
    Entry() = default;
    Entry(Entry&& other) noexcept
        : list_(std::exchange(other.list_, nullptr)), guid_(other.guid_), writer_(other.writer_) {}
    Entry& operator=(Entry&& other) noexcept {
      std::swap(list_, other.list_);
      std::swap(guid_, other.guid_);
      std::swap(writer_, other.writer_);
      return *this;
    }
    ~Entry() {
      if (list_ != nullptr) list_->Change(guid_, writer_, /*there=*/false);
    }

   private:
    friend class OwnEndpoints;
    Entry(std::shared_ptr<OwnEndpoints> list, const ros2::Guid& guid, bool writer)
        : list_(std::move(list)), guid_(guid), writer_(writer) {}

    std::shared_ptr<OwnEndpoints> list_;  // null = it lists nothing
    ros2::Guid guid_;
    bool writer_ = false;
  };

  // `topic` is a DDS name; one that is no ROS topic or service, ros_discovery_info among them,
  // belongs to no node and is not listed.
  Entry Add(absl::string_view topic, const ros2::Guid& guid, bool writer);

  List Now() const ABSL_LOCKS_EXCLUDED(mu_);
  uint64_t revision() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Change(const ros2::Guid& guid, bool writer, bool there) ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  uint64_t revision_ ABSL_GUARDED_BY(mu_) = 1;
  absl::btree_set<ros2::Guid> readers_ ABSL_GUARDED_BY(mu_);
  absl::btree_set<ros2::Guid> writers_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_OWN_ENDPOINTS_H_
