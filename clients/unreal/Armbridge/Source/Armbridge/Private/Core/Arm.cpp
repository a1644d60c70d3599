#include "Arm.h"

#include "rapidjson/document.h"
#include "rapidjson/stringbuffer.h"
#include "rapidjson/writer.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace Armbridge
{
namespace
{
const char* const NamedTopic = "/moveit_goal_named";
const char* const JointsTopic = "/moveit_goal_joints";
const char* const PoseTopic = "/moveit_goal_pose";
const char* const StopTopic = "/stop";
const char* const StatusTopic = "/moveit_goal_status";
const char* const JointStatesTopic = "/joint_states";
const char* const GripperAction = "/gripper_controller/gripper_cmd";
constexpr int JointStatesThrottleMs = 33;

using FWriter = rapidjson::Writer<rapidjson::StringBuffer>;

class FFrame
{
public:
	explicit FFrame(const char* Op) : Writer(Buffer)
	{
		Writer.StartObject();
		Add("op", Op);
	}

	FFrame& Add(const char* Key, const std::string& Text)
	{
		Writer.Key(Key);
		Writer.String(Text.c_str(), static_cast<rapidjson::SizeType>(Text.size()));
		return *this;
	}

	FFrame& Add(const char* Key, double Number)
	{
		Writer.Key(Key);
		Writer.Double(Number);
		return *this;
	}

	FFrame& Add(const char* Key, int64_t Number)
	{
		Writer.Key(Key);
		Writer.Int64(Number);
		return *this;
	}

	FFrame& Open(const char* Key)
	{
		Writer.Key(Key);
		Writer.StartObject();
		return *this;
	}

	FFrame& Close()
	{
		Writer.EndObject();
		return *this;
	}

	FFrame& Header(const std::string& Stamp)
	{
		const size_t Dot = Stamp.find('.');
		Open("header").Open("stamp");
		Add("sec", static_cast<int64_t>(std::atoll(Stamp.substr(0, Dot).c_str())));
		Add("nanosec", static_cast<int64_t>(std::atoll(Stamp.substr(Dot + 1).c_str())));
		return Close().Add("frame_id", "base_link").Close();
	}

	std::string Text()
	{
		Writer.EndObject();
		return std::string(Buffer.GetString(), Buffer.GetSize());
	}

	rapidjson::StringBuffer Buffer;
	FWriter Writer;
};

std::string Advertise(const char* Topic, const char* Type)
{
	return FFrame("advertise").Add("topic", Topic).Add("type", Type).Text();
}

FRequest Refused(const std::string& Error)
{
	FRequest Request;
	Request.Error = Error;
	return Request;
}

FRequest Accepted(const std::string& Frame)
{
	FRequest Request;
	Request.Frame = Frame;
	return Request;
}

const rapidjson::Value* Member(const rapidjson::Value& Object, const char* Key)
{
	if (!Object.IsObject())
	{
		return nullptr;
	}
	const auto Found = Object.FindMember(Key);
	return Found == Object.MemberEnd() ? nullptr : &Found->value;
}

std::string Text(const rapidjson::Value& Object, const char* Key)
{
	const rapidjson::Value* Found = Member(Object, Key);
	return Found && Found->IsString() ? std::string(Found->GetString(), Found->GetStringLength()) : std::string();
}

bool IsTrue(const rapidjson::Value& Object, const char* Key)
{
	const rapidjson::Value* Found = Member(Object, Key);
	return Found && Found->IsBool() && Found->GetBool();
}

/** The value of a key of a diagnostic_msgs/DiagnosticStatus. */
std::string ValueOf(const rapidjson::Value& Status, const char* Key)
{
	const rapidjson::Value* Values = Member(Status, "values");
	if (Values && Values->IsArray())
	{
		for (const rapidjson::Value& Pair : Values->GetArray())
		{
			if (Text(Pair, "key") == Key)
			{
				return Text(Pair, "value");
			}
		}
	}
	return std::string();
}

FEvent Ended(FEvent::EKind Kind, int Code, const std::string& Message)
{
	FEvent Event;
	Event.Kind = Kind;
	Event.Code = Code;
	Event.Message = Message;
	return Event;
}
}

std::vector<std::string> FArm::Setup(const std::string& Token)
{
	std::vector<std::string> Frames;
	if (!Token.empty())
	{
		// The server closes a connection whose first message is another one.
		Frames.push_back(FFrame("auth").Add("token", Token).Text());
	}
	Frames.push_back(FFrame("set_level").Add("level", "error").Text());
	Frames.push_back(Advertise(NamedTopic, "std_msgs/String"));
	Frames.push_back(Advertise(JointsTopic, "sensor_msgs/JointState"));
	Frames.push_back(Advertise(PoseTopic, "geometry_msgs/PoseStamped"));
	Frames.push_back(Advertise(StopTopic, "std_msgs/Empty"));
	Frames.push_back(FFrame("subscribe").Add("topic", StatusTopic).Add("type", "diagnostic_msgs/DiagnosticStatus").Text());
	Frames.push_back(FFrame("subscribe")
						 .Add("topic", JointStatesTopic)
						 .Add("type", "sensor_msgs/JointState")
						 .Add("throttle_rate", static_cast<int64_t>(JointStatesThrottleMs))
						 .Text());
	return Frames;
}

std::string FArm::Stop()
{
	return FFrame("publish").Add("topic", StopTopic).Open("msg").Close().Text();
}

FRequest FArm::MoveToNamed(const std::string& Target)
{
	GoalStamp.clear();
	bNamed = true;
	++NamedWaiting;
	return Accepted(FFrame("publish").Add("topic", NamedTopic).Open("msg").Add("data", Target).Close().Text());
}

FRequest FArm::MoveJoints(int64_t NowMs, const std::vector<std::string>& Names, const std::vector<double>& PositionsRad)
{
	if (Names.size() != PositionsRad.size())
	{
		return Refused(std::to_string(Names.size()) + " joints have " + std::to_string(PositionsRad.size()) + " positions");
	}
	for (size_t Joint = 0; Joint < Names.size(); ++Joint)
	{
		if (!std::isfinite(PositionsRad[Joint]))
		{
			return Refused("the position of " + Names[Joint] + " is no number");
		}
	}
	FFrame Frame("publish");
	Frame.Add("topic", JointsTopic).Open("msg").Header(NewStamp(NowMs));
	Frame.Writer.Key("name");
	Frame.Writer.StartArray();
	for (const std::string& Name : Names)
	{
		Frame.Writer.String(Name.c_str());
	}
	Frame.Writer.EndArray();
	Frame.Writer.Key("position");
	Frame.Writer.StartArray();
	for (const double Position : PositionsRad)
	{
		Frame.Writer.Double(Position);
	}
	Frame.Writer.EndArray();
	return Accepted(Frame.Close().Text());
}

FRequest FArm::MoveTip(int64_t NowMs, const FTriple& Position, const FRotation* Rotation)
{
	const bool bTurned = Rotation != nullptr;
	const double Sum = Position.X + Position.Y + Position.Z + (bTurned ? Rotation->X + Rotation->Y + Rotation->Z + Rotation->W : 0.0);
	if (!std::isfinite(Sum))
	{
		return Refused("the pose of the tip holds what is no number");
	}
	FFrame Frame("publish");
	Frame.Add("topic", PoseTopic).Open("msg").Header(NewStamp(NowMs)).Open("pose");
	Frame.Open("position").Add("x", Position.X).Add("y", Position.Y).Add("z", Position.Z).Close();
	if (bTurned)
	{
		Frame.Open("orientation").Add("x", Rotation->X).Add("y", Rotation->Y).Add("z", Rotation->Z).Add("w", Rotation->W).Close();
	}
	return Accepted(Frame.Close().Close().Text());
}

FRequest FArm::MoveGripper(double PositionRad, double MaxEffort)
{
	if (!std::isfinite(PositionRad) || !std::isfinite(MaxEffort))
	{
		return Refused("the gripper's position or effort is no number");
	}
	GripperId = "gripper " + std::to_string(++Goals);
	FFrame Frame("send_action_goal");
	Frame.Add("id", GripperId).Add("action", GripperAction).Add("action_type", "control_msgs/action/GripperCommand");
	Frame.Open("args").Open("command").Add("position", PositionRad).Add("max_effort", MaxEffort).Close().Close();
	return Accepted(Frame.Text());
}

std::string FArm::NewStamp(int64_t NowMs)
{
	char Written[48];
	const int Nanoseconds = static_cast<int>(NowMs % 1000) * 1000000 + ++Goals % 1000000;
	std::snprintf(Written, sizeof(Written), "%lld.%09d", static_cast<long long>(NowMs / 1000), Nanoseconds);
	GoalStamp = Written;
	bNamed = false;
	return GoalStamp;
}

std::vector<FEvent> FArm::Take(const std::string& Frame)
{
	std::vector<FEvent> Events;
	rapidjson::Document Operation;
	Operation.Parse<rapidjson::kParseIterativeFlag>(Frame.c_str(), Frame.size());
	if (Operation.HasParseError() || !Operation.IsObject())
	{
		return Events;
	}
	const std::string Op = Text(Operation, "op");
	const std::string Topic = Text(Operation, "topic");
	const rapidjson::Value* Message = Member(Operation, "msg");
	if (Op == "status")
	{
		Events.push_back(Ended(FEvent::EKind::Refused, 0, Text(Operation, "msg")));
	}
	else if (Op == "action_result" && !GripperId.empty() && Text(Operation, "id") == GripperId)
	{
		GripperId.clear();
		const rapidjson::Value* Values = Member(Operation, "values");
		const bool bReached = Values && IsTrue(*Values, "reached_goal");
		const bool bStalled = Values && IsTrue(*Values, "stalled");
		// Of a goal that was refused, values is a sentence.
		const std::string Sentence = bReached ? "the gripper is there"
			: bStalled                        ? "the gripper holds something"
			: Values && Values->IsString()    ? Text(Operation, "values")
											  : "the gripper did not get there";
		Events.push_back(Ended(FEvent::EKind::GripperEnded, bReached || bStalled ? 1 : 0, Sentence));
	}
	else if (Op == "publish" && Message && Topic == JointStatesTopic)
	{
		const rapidjson::Value* Names = Member(*Message, "name");
		const rapidjson::Value* Positions = Member(*Message, "position");
		if (Names && Positions && Names->IsArray() && Positions->IsArray() && Names->Size() == Positions->Size())
		{
			FEvent Event;
			Event.Kind = FEvent::EKind::Joints;
			for (rapidjson::SizeType Joint = 0; Joint < Names->Size(); ++Joint)
			{
				if ((*Names)[Joint].IsString() && (*Positions)[Joint].IsNumber())
				{
					Event.Names.push_back((*Names)[Joint].GetString());
					Event.PositionsRad.push_back((*Positions)[Joint].GetDouble());
				}
			}
			Events.push_back(Event);
		}
	}
	else if (Op == "publish" && Message && Topic == StatusTopic && ValueOf(*Message, "state") == "done")
	{
		const bool bOfNamed = Text(*Message, "name") == NamedTopic;
		NamedWaiting -= bOfNamed && NamedWaiting > 0 ? 1 : 0;
		if (GoalStamp.empty() ? bNamed && bOfNamed && NamedWaiting == 0 : ValueOf(*Message, "stamp") == GoalStamp)
		{
			GoalStamp.clear();
			bNamed = false;
			Events.push_back(
				Ended(FEvent::EKind::GoalEnded, std::atoi(ValueOf(*Message, "code").c_str()), Text(*Message, "message")));
		}
	}
	return Events;
}

std::vector<FEvent> FArm::Lose()
{
	std::vector<FEvent> Events;
	if (bNamed || !GoalStamp.empty())
	{
		Events.push_back(Ended(
			FEvent::EKind::GoalEnded, ConnectionLost, "the connection was lost before the goal's end came; the arm may still be moving"));
	}
	if (!GripperId.empty())
	{
		Events.push_back(Ended(FEvent::EKind::GripperEnded, 0, "the connection was lost before the gripper's end came"));
	}
	GoalStamp.clear();
	bNamed = false;
	NamedWaiting = 0;
	GripperId.clear();
	return Events;
}
}
