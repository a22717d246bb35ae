#include "services/dds/dds_entity.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "dds/dds.h"

namespace rips::dds {

static_assert(sizeof(EntityHandle) == sizeof(dds_entity_t));
static_assert(sizeof(InstanceHandle) == sizeof(dds_instance_handle_t));

void DdsEntity::Reset() {
  // Fails only if a parent took the entity along, which is as good.
  if (handle_ > 0) dds_delete(handle_);
  handle_ = 0;
}

absl::Status DdsError(absl::string_view doing, int32_t code) {
  const std::string text = absl::StrCat(doing, ": ", dds_strretcode(code));
  switch (code) {
    case DDS_RETCODE_TIMEOUT:
      return absl::DeadlineExceededError(text);
    case DDS_RETCODE_OUT_OF_RESOURCES:
      return absl::ResourceExhaustedError(text);
    case DDS_RETCODE_BAD_PARAMETER:
      return absl::InvalidArgumentError(text);
    case DDS_RETCODE_NOT_ALLOWED_BY_SECURITY:
      return absl::PermissionDeniedError(text);
    case DDS_RETCODE_PRECONDITION_NOT_MET:
      return absl::FailedPreconditionError(text);
    default:
      return absl::InternalError(text);
  }
}

}  // namespace rips::dds
