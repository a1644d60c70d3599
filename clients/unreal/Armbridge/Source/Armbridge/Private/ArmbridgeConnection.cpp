#include "ArmbridgeConnection.h"

#include "IWebSocket.h"
#include "WebSocketsModule.h"

DEFINE_LOG_CATEGORY_STATIC(LogArmbridge, Log, All);

FArmbridgeConnection::FArmbridgeConnection(const FString& InUrl, const FString& InToken) : Url(InUrl), Token(InToken)
{
}

FArmbridgeConnection::~FArmbridgeConnection()
{
	FTSTicker::GetCoreTicker().RemoveTicker(Waiting);
	// Without this the connection may outlive play, and with it the control lease.
	Release();
}

void FArmbridgeConnection::Open()
{
	Release();
	Socket = FWebSocketsModule::Get().CreateWebSocket(Url);
	Socket->OnConnected().AddSP(this, &FArmbridgeConnection::HandleConnected);
	Socket->OnConnectionError().AddSP(this, &FArmbridgeConnection::HandleError);
	Socket->OnClosed().AddSP(this, &FArmbridgeConnection::HandleClosed);
	Socket->OnMessage().AddSP(this, &FArmbridgeConnection::HandleMessage);
	Socket->Connect();
}

bool FArmbridgeConnection::IsOpen() const
{
	return Socket.IsValid() && Socket->IsConnected();
}

bool FArmbridgeConnection::Send(const std::string& Frame)
{
	if (!IsOpen())
	{
		return false;
	}
	Socket->Send(FString(UTF8_TO_TCHAR(Frame.c_str())));
	return true;
}

void FArmbridgeConnection::Release()
{
	if (Socket.IsValid())
	{
		Socket->OnConnected().RemoveAll(this);
		Socket->OnConnectionError().RemoveAll(this);
		Socket->OnClosed().RemoveAll(this);
		Socket->OnMessage().RemoveAll(this);
		Socket->Close();
		Socket.Reset();
	}
}

void FArmbridgeConnection::HandleConnected()
{
	UE_LOG(LogArmbridge, Log, TEXT("connected to %s"), *Url);
	DelayS = Armbridge::FirstDelayS;
	for (const std::string& Frame : Armbridge::FArm::Setup(TCHAR_TO_UTF8(*Token)))
	{
		Send(Frame);
	}
}

void FArmbridgeConnection::HandleError(const FString& Error)
{
	UE_LOG(LogArmbridge, Warning, TEXT("cannot connect to %s: %s"), *Url, *Error);
	ConnectLater();
}

void FArmbridgeConnection::HandleClosed(int32 Code, const FString& Reason, bool bWasClean)
{
	UE_LOG(LogArmbridge, Warning, TEXT("connection closed (%d): %s"), Code, *Reason);
	Broadcast(Arm.Lose());
	ConnectLater();
}

void FArmbridgeConnection::HandleMessage(const FString& Text)
{
	Broadcast(Arm.Take(TCHAR_TO_UTF8(*Text)));
}

void FArmbridgeConnection::Broadcast(const std::vector<Armbridge::FEvent>& Events)
{
	for (const Armbridge::FEvent& Event : Events)
	{
		if (Event.Kind == Armbridge::FEvent::EKind::Refused)
		{
			UE_LOG(LogArmbridge, Warning, TEXT("refused: %s"), UTF8_TO_TCHAR(Event.Message.c_str()));
		}
		OnEvent.Broadcast(Event);
	}
}

void FArmbridgeConnection::ConnectLater()
{
	FTSTicker::GetCoreTicker().RemoveTicker(Waiting);
	const TWeakPtr<FArmbridgeConnection> Weak = AsShared();
	Waiting = FTSTicker::GetCoreTicker().AddTicker(
		FTickerDelegate::CreateLambda([Weak](float) {
			if (const TSharedPtr<FArmbridgeConnection> Self = Weak.Pin())
			{
				Self->Open();
			}
			return false;
		}),
		static_cast<float>(DelayS));
	DelayS = Armbridge::NextDelay(DelayS);
}
