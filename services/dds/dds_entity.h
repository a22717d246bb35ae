// Owner of one Cyclone entity, and how Cyclone's return codes become absl::Status.
#ifndef RIPS_SERVICES_DDS_DDS_ENTITY_H_
#define RIPS_SERVICES_DDS_DDS_ENTITY_H_

#include <cstdint>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::dds {

// Cyclone's dds_entity_t. Values are reused after deletion: never a key of anything that lives
// longer than the entity; use instance handles or GUIDs.
using EntityHandle = int32_t;
// Cyclone's dds_instance_handle_t: names one entity within this process; never reused.
using InstanceHandle = uint64_t;

// Deletes the entity (with its children, waiting for callbacks in progress) when it goes.
class [[nodiscard]] DdsEntity {
 public:
  DdsEntity() = default;
  explicit DdsEntity(EntityHandle handle) : handle_(handle) {}
  DdsEntity(DdsEntity&& other) noexcept : handle_(std::exchange(other.handle_, 0)) {}
  DdsEntity& operator=(DdsEntity&& other) noexcept {
    std::swap(handle_, other.handle_);
    return *this;
  }
  ~DdsEntity() { Reset(); }

  // <= 0: none.
  EntityHandle get() const { return handle_; }
  void Reset();

 private:
  EntityHandle handle_ = 0;
};

// "<doing>: <Cyclone's text>". `code` is negative. Timeout -> DeadlineExceeded, out of resources
// -> ResourceExhausted, bad parameter -> InvalidArgument, not allowed by security ->
// PermissionDenied, precondition not met -> FailedPrecondition, else Internal.
absl::Status DdsError(absl::string_view doing, int32_t code);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_DDS_ENTITY_H_
