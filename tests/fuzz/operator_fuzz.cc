// Whatever an operator, a sensor or an actuator asks: the check of its fields says the same each
// time, never quotes what was sent, and what our senders cut stays cut.
//
// The first byte picks the method, the rest is its request.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "google/protobuf/descriptor.h"
#include "google/protobuf/message.h"
#include "rips/v1/actuator.pb.h"
#include "rips/v1/enrolment.pb.h"
#include "rips/v1/operator.pb.h"
#include "rips/v1/sensor.pb.h"
#include "services/base/check.h"
#include "services/wire_limits/field_limits.h"

namespace rips::wire_limits {
namespace {

constexpr size_t kTextBytesMax = 300;

// One empty request of each method.
std::vector<const google::protobuf::Message*> Requests() {
  std::vector<const google::protobuf::Message*> requests;
  for (const google::protobuf::FileDescriptor* file :
       {v1::ListAgentsRequest::descriptor()->file(), v1::SensorMessage::descriptor()->file(),
        v1::ActuatorMessage::descriptor()->file(), v1::EnrolRequest::descriptor()->file()}) {
    for (int i = 0; i < file->service_count(); ++i) {
      for (int j = 0; j < file->service(i)->method_count(); ++j) {
        requests.push_back(google::protobuf::MessageFactory::generated_factory()->GetPrototype(
            file->service(i)->method(j)->input_type()));
      }
    }
  }
  return requests;
}

void CheckAndCut(google::protobuf::Message& message) {
  if (const auto hit = Check(message)) {
    const std::string text = hit->Text();
    RIPS_CHECK(text.size() < kTextBytesMax, "a text as long as what was sent");
    RIPS_CHECK(hit->ToStatus().code() == absl::StatusCode::kInvalidArgument, "another status");
    RIPS_CHECK(Check(message)->Text() == text, "another answer to the same message");
  }
  CutToLimits(message);
  const std::string cut = message.SerializeAsString();
  CutToLimits(message);
  RIPS_CHECK(message.SerializeAsString() == cut, "what was cut is cut again");
}

}  // namespace
}  // namespace rips::wire_limits

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const auto requests = rips::wire_limits::Requests();
  if (size == 0) return 0;
  const std::unique_ptr<google::protobuf::Message> message(
      requests[data[0] % requests.size()]->New());
  if (!message->ParseFromArray(data + 1, static_cast<int>(size - 1))) return 0;
  rips::wire_limits::CheckAndCut(*message);
  return 0;
}
